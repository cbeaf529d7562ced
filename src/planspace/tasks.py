"""The reinforcement learning tasks, as data: what starts, what is observed, what is rewarded, what ends.

Every function takes batches: `before` and `after` are planning states [env, state], `control` is what was
applied after clipping [env, control], `target` is [env, 2] for a reacher and [env, 0] for a cart-pole.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from planspace.errors import unknown
from planspace.physics.angles import wrap
from planspace.physics.simulate import ASSETS, load_model
from planspace.physics.space import StateSpace

LINK = 0.1
"""Length of the reacher's first link [m]."""
TIP = 0.11
"""From the reacher's second joint to its fingertip [m]."""
DISK = 0.2
"""Radius of the disk the reacher's targets are drawn from [m]."""

ObsForm = Literal["raw", "wrapped", "trig"]
"""`raw`: what the task observes, angles as they are; `wrapped`: the same with angles on a circle brought to
(-pi, pi]; `trig`: raw with sin and cos of its angles."""
_OBS_FORMS: tuple[ObsForm, ...] = get_args(ObsForm)


@dataclass(frozen=True)
class Task:
    """One task. Sizes: n joints make a state of 2 n numbers, positions first."""

    name: str
    """Its name on the command line."""
    env_id: str
    """Its name in Gymnasium."""
    model: str
    """MJCF file among the assets."""
    joints: tuple[str, ...]
    """The joints that make the state."""
    problem: str
    """The planning problem whose demonstrations suit it."""
    start_low: tuple[float, ...]
    """Episodes start uniformly between these ..."""
    start_high: tuple[float, ...]
    """... and these [m, rad, m/s, rad/s]."""
    horizon: int
    """Steps an episode lasts at most."""
    frame_skip: int
    """Physics steps a step."""
    observe: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """(states, targets) to what is observed raw."""
    obs_fields: tuple[tuple[str, str], ...]
    """Name and unit of each number of it."""
    trig_columns: tuple[int, ...]
    """Angles of the state whose sin and cos the `trig` observation adds to the raw one."""
    circular_columns: tuple[int, ...]
    """Angles of the state that lie on a circle."""
    reward: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    """(before, after, control, targets) to the reward of a step."""
    terminated: Callable[[np.ndarray], np.ndarray]
    """States after a step to whether the episode ends there."""
    has_target: bool = False
    """Whether a target is drawn for each episode."""

    def compile(self) -> tuple[mujoco.MjModel, StateSpace]:
        """Compiles the model and reads its state space."""
        model = load_model((ASSETS / self.model).read_text())
        return model, StateSpace.from_model(model, self.joints)

    def sample_starts(
        self, num: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "env state"], Float[np.ndarray, "env target"]]:
        """Draws the first states and the targets of some episodes."""
        states = rng.uniform(self.start_low, self.start_high, (num, len(self.start_low)))
        if not self.has_target:
            return states, np.empty((num, 0))
        angle = rng.uniform(-np.pi, np.pi, num)
        radius = DISK * np.sqrt(rng.uniform(0.0, 1.0, num))
        return states, radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def observe_as(
        self,
        form: ObsForm,
        states: Float[np.ndarray, "env state"],
        targets: Float[np.ndarray, "env target"],
    ) -> Float[np.ndarray, "env obs"]:
        """The observation in one of its forms."""
        if form == "wrapped" and self.circular_columns:
            states = states.copy()
            states[:, self.circular_columns] = wrap(states[:, self.circular_columns])
        raw = self.observe(states, targets)
        if form != "trig":
            return raw
        angles = states[:, self.trig_columns]
        return np.concatenate([raw, np.sin(angles), np.cos(angles)], axis=1)

    def fields(self, form: ObsForm) -> dict[str, str]:
        """Name and unit of each number of an observation, in order."""
        own = dict(self.obs_fields)
        if form == "trig":
            angles = [name for name, unit in self.obs_fields if unit == "rad"][: len(self.trig_columns)]
            own |= {f"{function}_{name}": "" for function in ("sin", "cos") for name in angles}
        return own


def fingertip(states: Float[np.ndarray, "env 4"]) -> Float[np.ndarray, "env 2"]:
    """Where the reacher's fingertip is [m]."""
    a, b = states[:, 0], states[:, 0] + states[:, 1]
    x = LINK * np.cos(a) + TIP * np.cos(b)
    return np.stack([x, LINK * np.sin(a) + TIP * np.sin(b)], axis=1)


def _state(states: np.ndarray, targets: np.ndarray) -> np.ndarray:
    return states


def _never(states: np.ndarray) -> Bool[np.ndarray, " env"]:
    return np.zeros(len(states), dtype=bool)


def _balance_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> np.ndarray:
    return np.ones(len(after))


def _has_fallen(states: np.ndarray) -> Bool[np.ndarray, " env"]:
    return ~((np.abs(states[:, 1]) <= 0.2) & np.isfinite(states).all(axis=1))


def _swing_up_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> np.ndarray:
    angle = np.abs(wrap(after[:, 1]))
    return -angle - 0.1 * np.sum(control**2, axis=1) + (angle < 0.1)


def _reach_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> np.ndarray:
    # from the pose before the step, as in Gymnasium's Reacher
    distance = np.linalg.norm(fingertip(before) - target, axis=1)
    return -distance - 0.1 * np.sum(control**2, axis=1)


def _reacher_raw(states: np.ndarray, targets: np.ndarray) -> np.ndarray:
    angles, velocities = states[:, :2], states[:, 2:]
    return np.concatenate([angles, targets, velocities, fingertip(states) - targets], axis=1)


def _reacher_trig(states: np.ndarray, targets: np.ndarray) -> np.ndarray:
    angles, velocities = states[:, :2], states[:, 2:]
    parts = [np.cos(angles), np.sin(angles), targets, velocities, fingertip(states) - targets]
    return np.concatenate(parts, axis=1)


_REACHER_JOINTS = ("joint0", "joint1")
_REACHER_TAIL = (
    ("target_x", "m"),
    ("target_y", "m"),
    ("joint0vel", "rad/s"),
    ("joint1vel", "rad/s"),
    ("to_target_x", "m"),
    ("to_target_y", "m"),
)
_CARTPOLE_STATE = (("slider", "m"), ("hinge", "rad"), ("slidervel", "m/s"), ("hingevel", "rad/s"))

TASKS: dict[str, Task] = {
    task.name: task
    for task in (
        Task(
            name="cartpole",
            env_id="planspace/CartPole-v0",
            model="cartpole.xml",
            joints=("slider", "hinge"),
            problem="cartpole",
            start_low=(-0.01,) * 4,
            start_high=(0.01,) * 4,
            horizon=100,
            frame_skip=2,
            observe=_state,
            obs_fields=_CARTPOLE_STATE,
            trig_columns=(1,),
            circular_columns=(1,),
            reward=_balance_reward,
            terminated=_has_fallen,
        ),
        Task(
            name="cartpole-swingup",
            env_id="planspace/CartPoleSwingUp-v0",
            model="cartpole.xml",
            joints=("slider", "hinge"),
            problem="cartpole-swingup",
            start_low=(-0.1, -3.14, -0.1, -0.5),
            start_high=(0.1, 3.14, 0.1, 0.5),
            horizon=200,
            frame_skip=2,
            observe=_state,
            obs_fields=_CARTPOLE_STATE,
            trig_columns=(1,),
            circular_columns=(1,),
            reward=_swing_up_reward,
            terminated=_never,
        ),
        Task(
            name="reacher-trig",
            env_id="planspace/ReacherTrig-v0",
            model="reacher.xml",
            joints=_REACHER_JOINTS,
            problem="reacher",
            start_low=(-0.1, -0.1, -0.005, -0.005),
            start_high=(0.1, 0.1, 0.005, 0.005),
            horizon=100,
            frame_skip=2,
            observe=_reacher_trig,
            obs_fields=(
                *((f"{function}_{joint}", "") for function in ("cos", "sin") for joint in _REACHER_JOINTS),
                *_REACHER_TAIL,
            ),
            trig_columns=(),  # it observes them instead of the angles already
            circular_columns=(),
            reward=_reach_reward,
            terminated=_never,
            has_target=True,
        ),
        Task(
            name="reacher-raw",
            env_id="planspace/ReacherRaw-v0",
            model="reacher.xml",
            joints=_REACHER_JOINTS,
            problem="reacher",
            start_low=(-0.1, -0.1, -0.005, -0.005),
            start_high=(0.1, 0.1, 0.005, 0.005),
            horizon=100,
            frame_skip=2,
            observe=_reacher_raw,
            obs_fields=(*((joint, "rad") for joint in _REACHER_JOINTS), *_REACHER_TAIL),
            trig_columns=(0, 1),
            circular_columns=(),  # they are limited
            reward=_reach_reward,
            terminated=_never,
            has_target=True,
        ),
    )
}


def find_task(name: str) -> Task:
    """The task of a command-line name.

    Raises:
        UsageError: there is none; the nearest name is suggested.
    """
    if name not in TASKS:
        raise unknown("task", name, TASKS)
    return TASKS[name]


def find_obs_form(name: str) -> ObsForm:
    """The form of observation of a name.

    Raises:
        UsageError: there is none.
    """
    for form in _OBS_FORMS:
        if form == name:
            return form
    raise unknown("form of observation", name, _OBS_FORMS)
