"""The reinforcement learning tasks, as data: what starts, what is observed, what is rewarded, what ends.

Every function takes batches: `before` and `after` are planning states [env, state], `control` is what was
applied after clipping [env, control], `target` is [env, 2] for a reacher and [env, 0] for the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.errors import unknown
from planspace.mjcf.compile import ASSETS, load_model
from planspace.physics import quaternion
from planspace.physics.angles import wrap
from planspace.physics.space import StateSpace
from planspace.tasks.observation_types import OBSERVATION_TYPES, ObservationType, RewardType
from planspace.tasks.rewards import (
    Pose,
    balance_reward,
    fingertip,
    has_fallen,
    has_reached,
    is_up,
    never,
    reach_reward,
    swing_up_reward,
    swing_up_reward_of_2020,
)

DISK = 0.2
"""Radius of the disk the reacher's targets are drawn from [m]."""

Form = TypeVar("Form", bound=str)


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
    at_goal: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """(states, targets) to whether that is where the task is to get."""
    reward_2020: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None
    """The reward with the mistakes of 2020, where it made some."""
    terminated: Callable[[np.ndarray], np.ndarray] = never
    """States after a step to whether the episode ends there."""
    quaternion: int | None = None
    """Where in the state a quaternion begins, if there is one; starts are drawn and brought to length 1."""
    has_target: bool = False
    """Whether a target is drawn for each episode."""

    @property
    def reward_types(self) -> tuple[RewardType, ...]:
        """The forms of reward it has."""
        return ("dense", "sparse") if self.reward_2020 is None else ("dense", "sparse", "2020")

    def compile(self) -> tuple[mujoco.MjModel, StateSpace]:
        """Compiles the model and reads its state space."""
        model = load_model((ASSETS / self.model).read_text())
        return model, StateSpace.from_model(model, self.joints)

    def sample_starts(
        self, num: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "env state"], Float[np.ndarray, "env target"]]:
        """Draws the first states and the targets of some episodes."""
        states = rng.uniform(self.start_low, self.start_high, (num, len(self.start_low)))
        if self.quaternion is not None:
            part = slice(self.quaternion, self.quaternion + 4)
            states[:, part] = quaternion.normalise(states[:, part])
        if not self.has_target:
            return states, np.empty((num, 0))
        angle = rng.uniform(-np.pi, np.pi, num)
        radius = DISK * np.sqrt(rng.uniform(0.0, 1.0, num))
        return states, radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def observe_as(
        self,
        form: ObservationType,
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

    def reward_as(
        self,
        form: RewardType,
        before: Float[np.ndarray, "env state"],
        after: Float[np.ndarray, "env state"],
        control: Float[np.ndarray, "env control"],
        targets: Float[np.ndarray, "env target"],
    ) -> Float[np.ndarray, " env"]:
        """The reward of a step in one of its forms."""
        if form == "sparse":
            return self.at_goal(after, targets).astype(float)
        if form == "2020" and self.reward_2020 is not None:
            return self.reward_2020(before, after, control, targets)
        return self.reward(before, after, control, targets)

    def fields(self, form: ObservationType) -> dict[str, str]:
        """Name and unit of each number of an observation, in order."""
        own = dict(self.obs_fields)
        if form == "trig":
            angles = [self.obs_fields[column][0] for column in self.trig_columns]  # they stand alike in both
            own |= {f"{function}_{name}": "" for function in ("sin", "cos") for name in angles}
        return own


def _state(states: np.ndarray, targets: np.ndarray) -> np.ndarray:
    return states


def _reacher_raw(states: np.ndarray, targets: np.ndarray) -> np.ndarray:
    angles, velocities = states[:, :2], states[:, 2:]
    return np.concatenate([angles, targets, velocities, fingertip(states) - targets], axis=1)


def _reacher_trig(states: np.ndarray, targets: np.ndarray) -> np.ndarray:
    angles, velocities = states[:, :2], states[:, 2:]
    parts = [np.cos(angles), np.sin(angles), targets, velocities, fingertip(states) - targets]
    return np.concatenate(parts, axis=1)


def _joint_fields(joints: Sequence[str]) -> tuple[tuple[str, str], ...]:
    return (*((joint, "rad") for joint in joints), *((f"{joint}vel", "rad/s") for joint in joints))


def _pose_task(pose: Pose, **rest: Any) -> Task:
    """A task whose state is what is observed, and whose aim is a pose."""
    return Task(
        model=pose.model,
        joints=pose.joints,
        frame_skip=2,
        observe=_state,
        reward=pose.reward,
        at_goal=pose.at_goal,
        **rest,
    )


_REACHER_JOINTS = ("joint0", "joint1")
_REACHER_TAIL = (
    ("target_x", "m"),
    ("target_y", "m"),
    ("joint0vel", "rad/s"),
    ("joint1vel", "rad/s"),
    ("to_target_x", "m"),
    ("to_target_y", "m"),
)
_PENDULUM = Pose("pendulum.xml", ("hinge",), (0.0,) * 2, (1.0,), effort=0.1)
_ACROBOT = Pose("acrobot.xml", ("shoulder", "elbow"), (0.0,) * 4, (0.5,) * 2, effort=0.001)
_PLANAR = Pose(
    "quadrotor-planar.xml", ("x", "z", "pitch"), (0.0,) * 6, (1.0, 1.0, 0.2), effort=0.01, hold=2.4525
)
_QUADROTOR = Pose(
    "quadrotor.xml",
    ("body",),
    (0.0, 0.0, 0.0, 1.0, *(0.0,) * 9),
    (1.0, 1.0, 1.0, 0.2, 0.2, 0.2),
    effort=0.02,
    hold=1.22625,
)
_ARM_JOINTS = tuple(f"joint{i}" for i in range(1, 8))
_ARM = Pose("arm.xml", _ARM_JOINTS, (1.0, 0.8, 0.0, 1.1, 0.0, 0.3, 0.0, *(0.0,) * 7), (0.2,) * 7, effort=1e-4)
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
            reward=balance_reward,
            at_goal=is_up,
            terminated=has_fallen,
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
            reward=swing_up_reward,
            reward_2020=swing_up_reward_of_2020,
            at_goal=is_up,
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
            reward=reach_reward,
            at_goal=has_reached,
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
            reward=reach_reward,
            at_goal=has_reached,
            has_target=True,
        ),
        _pose_task(
            _PENDULUM,
            name="pendulum-swingup",
            env_id="planspace/PendulumSwingUp-v0",
            problem="pendulum",
            start_low=(-3.14, -0.1),
            start_high=(3.14, 0.1),
            horizon=200,
            obs_fields=_joint_fields(_PENDULUM.joints),
            trig_columns=(0,),
            circular_columns=(0,),
        ),
        _pose_task(
            _ACROBOT,
            name="acrobot-swingup",
            env_id="planspace/AcrobotSwingUp-v0",
            problem="acrobot",
            start_low=(2.64, -0.5, -0.1, -0.1),
            start_high=(3.64, 0.5, 0.1, 0.1),
            horizon=300,
            obs_fields=_joint_fields(_ACROBOT.joints),
            trig_columns=(0, 1),
            circular_columns=(0, 1),
        ),
        _pose_task(
            _PLANAR,
            name="quadrotor-planar",
            env_id="planspace/QuadrotorPlanar-v0",
            problem="quadrotor-planar",
            start_low=(-1.5, -1.5, -1.0, -0.5, -0.5, -0.5),
            start_high=(1.5, 1.5, 1.0, 0.5, 0.5, 0.5),
            horizon=150,
            obs_fields=(
                ("x", "m"),
                ("z", "m"),
                ("pitch", "rad"),
                ("xvel", "m/s"),
                ("zvel", "m/s"),
                ("pitchvel", "rad/s"),
            ),
            trig_columns=(2,),
            circular_columns=(2,),
        ),
        _pose_task(
            _QUADROTOR,
            name="quadrotor",
            env_id="planspace/Quadrotor-v0",
            problem="quadrotor",
            start_low=(*(-1.5,) * 3, 0.8, *(-0.3,) * 3, *(-0.5,) * 6),
            start_high=(*(1.5,) * 3, 1.0, *(0.3,) * 3, *(0.5,) * 6),
            horizon=150,
            obs_fields=(
                *((f"body_{axis}", "m") for axis in "xyz"),
                *((f"body_q{part}", "") for part in "wxyz"),
                *((f"body_{axis}vel", "m/s") for axis in "xyz"),
                *((f"body_r{axis}vel", "rad/s") for axis in "xyz"),
            ),
            trig_columns=(),
            circular_columns=(),
            quaternion=3,
        ),
        _pose_task(
            _ARM,
            name="arm",
            env_id="planspace/Arm-v0",
            problem="arm",
            start_low=(-1.4, 0.6, -0.3, 0.9, -0.5, -0.5, -0.5, *(0.0,) * 7),
            start_high=(-0.8, 1.0, 0.3, 1.3, 0.5, 0.5, 0.5, *(0.0,) * 7),
            horizon=150,
            obs_fields=_joint_fields(_ARM.joints),
            trig_columns=tuple(range(7)),
            circular_columns=(),
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


def find_observation_type(name: str) -> ObservationType:
    """The form of observation of a name.

    Raises:
        UsageError: there is none.
    """
    return _find("form of observation", name, OBSERVATION_TYPES)


def find_reward_type(name: str, task: Task) -> RewardType:
    """The form of reward of a name.

    Raises:
        UsageError: the task has none of that name.
    """
    return _find(f"form of reward of {task.name}", name, task.reward_types)


def _find(what: str, name: str, forms: tuple[Form, ...]) -> Form:
    for form in forms:
        if form == name:
            return form
    raise unknown(what, name, forms)
