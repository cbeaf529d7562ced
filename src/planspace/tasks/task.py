"""Reinforcement learning tasks as data: where episodes start, what is observed, rewarded, and when they end.

A task is plain data plus functions, and anyone can make one in Python (docs/howto/own-task.md). Its functions
take batches, so that one call serves all environments:

    before, after   states [env, state]: joint positions, joint velocities, activations (see `physics.space`)
    control         what was applied, after clipping to the actuators' limits [env, control]
    target          the target of each episode [env, target]; [env, 0] for a task without targets

A function must treat each environment by itself: what it returns for one may not depend on the others.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from planspace.errors import UsageError, quoted
from planspace.mjcf.source import ModelFile, ModelSource
from planspace.physics.angles import wrap
from planspace.tasks.observation_types import OBSERVATION_TYPES, ObservationType, RewardType, find_name

if TYPE_CHECKING:  # importing planspace registers its tasks, and must not import MuJoCo
    import mujoco

    from planspace.physics.space import StateSpace
    from planspace.tasks.problem import Problem

PAGE = "docs/howto/own-task.md"
"""The how-to page that messages point to."""

Reward = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(before, after, control, target) to the reward of a step [env]."""
AtGoal = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(states, target) to whether each state is at the goal [env]."""
Observe = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(states, target) to observations [env, obs]."""
Terminated = Callable[[np.ndarray], np.ndarray]
"""States after a step to whether the episode ends there [env]."""
DrawTargets = Callable[[int, np.random.Generator], np.ndarray]
"""(number of episodes, random stream) to their targets [env, target]; a `draw_starts` returns states."""

OPTIONAL = ("draw_targets", "draw_starts", "reward_2020")
"""Functions that a task need not have."""


def never(states: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Return False for every environment: the task does not terminate."""
    return np.zeros(len(states), dtype=bool)


def states_only(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Observe the state itself."""
    return states


@dataclass(frozen=True, repr=False)
class Task:
    """One task. Everything that is said of a task stands here; no other list names it."""

    name: str
    """Its name on the command line, made of letters, digits, hyphens, underscores and dots. Names of tasks of
    DeepMind Control start with `dmc:`."""
    model: str | Path | ModelSource
    """The MJCF text, the path of an MJCF file, or the files of a model."""
    joints: tuple[str, ...]
    """The joints that make the state, in order."""
    start_low: Sequence[float | int]
    """Lower bound of the first states, which are drawn uniformly [m, rad, m/s, rad/s]."""
    start_high: Sequence[float | int]
    """Upper bound of the first states."""
    horizon: int
    """Actions in an episode before it is truncated."""
    reward: Reward
    """(before, after, control, target) to the reward of a step [env]."""
    at_goal: AtGoal
    """(states, target) to whether each state is at the goal [env]; the sparse reward pays 1 there."""
    frame_skip: int = 1
    """Physics steps in one step of the environment."""
    action_repeat: int = 1
    """Steps for which an action is held, and whose rewards are summed; see `tasks.action_repeat`."""
    observe: Observe = states_only
    """(states, target) to the raw observations [env, obs]; the default observes the state."""
    obs_fields: tuple[tuple[str, str], ...] = ()
    """Name and unit of each number of a raw observation; the default has the state's for `states_only`, and
    `obs_0`, `obs_1`, ... for other functions."""
    trig_columns: tuple[int, ...] | None = None
    """Columns of the state whose sine and cosine the `trig` observation appends; the default takes the
    unlimited hinges."""
    terminated: Terminated = never
    """States after a step to whether the episode ends there [env]; the default never ends one."""
    draw_targets: DrawTargets | None = None
    """(number, random stream) to the targets of that many episodes [env, target]; None means no target. A
    mocap body in the model is drawn at the target."""
    draw_starts: DrawTargets | None = None
    """(number, random stream) to the first states of that many episodes [env, state]; None draws them
    uniformly between `start_low` and `start_high`."""
    reward_2020: Reward | None = None
    """The reward of the 2020 code, if it had mistakes that `reward` does not have."""
    env_id: str = ""
    """Its Gymnasium id, such as `planspace/CartPole-v0`."""
    problem: "str | Path | Problem" = ""
    """The planning problem whose plans suit the task: a shipped name, the path of a problem file, or a
    problem, whose bounds of controls then hold in the task, too."""
    embedding_problem: str | Path = ""
    """The planning problem whose plans train the task's embeddings in studies, if it is not `problem`."""
    return_range: tuple[float, float] | None = None
    """Returns that count as 0 and 1 in averages over tasks: of doing nothing, and of solving the task."""
    solved_return: float | None = None
    """A seed has solved the task if its return is above this."""
    similar_return: float | None = None
    """Mean returns that differ by less than this count as equal in a study's claims."""
    paper_order: int | None = None
    """Position among the tasks of the paper's study; None for tasks that the paper does not have."""

    def __post_init__(self) -> None:
        """Turn lists into tuples and check what can be checked without the model.

        Raises:
            UsageError: a value does not fit; the message names the field and the how-to page.
        """
        for name in ("joints", "trig_columns", "obs_fields", "start_low", "start_high"):
            value = getattr(self, name)
            if isinstance(value, list | tuple | np.ndarray):
                object.__setattr__(self, name, _tuple(value, numbers=name.startswith("start")))
        check_fields(self)

    def __repr__(self) -> str:
        """Return the name, the joints and the horizon."""
        joints = self.joints if len(self.joints) <= 4 else (*self.joints[:3], "...")
        return f"Task({self.name!r}, joints {', '.join(joints)}, {self.horizon} steps)"

    # --- the model --------------------------------------------------------------------------------------

    @cached_property
    def source(self) -> ModelSource:
        """The files of the model.

        Raises:
            PlanspaceError: a file cannot be read.
        """
        if isinstance(self.model, ModelSource):
            return self.model
        if isinstance(self.model, str) and "<" in self.model:
            return ModelSource(self.model)
        from planspace.mjcf.read import read_model

        return read_model(ModelFile(Path(self.model)))

    @cached_property
    def space(self) -> "StateSpace":
        """The state space of the task's joints."""
        return self.compile()[1]

    def compile(self) -> "tuple[mujoco.MjModel, StateSpace]":
        """Compile the model and read its state space.

        Raises:
            PlanspaceError: the model does not compile.
            UsageError: a joint is not in the model.
        """
        from planspace.mjcf.compile import load_model
        from planspace.physics.space import StateSpace

        if not isinstance(self.problem, str | Path):
            if self.problem.joints != self.joints or self.problem.source != self.source:
                raise misfit(self, "problem", "has another model or other joints than the task")
            return self.problem.compile()
        model = load_model(self.source)
        return model, StateSpace.from_model(model, self.joints)

    @property
    def problem_name(self) -> str:
        """The name or the path of its planning problem; empty if it has none."""
        return str(self.problem) if isinstance(self.problem, str | Path) else self.problem.name

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the packages that provide the task, besides planspace and MuJoCo; none."""
        return {}

    @property
    def hash(self) -> str:
        """SHA-256 of everything that defines the task: model, numbers and the source of its functions.

        A file that a function reads, such as the model of a pose, counts by its content.
        """
        from planspace.tasks.task_hash import task_hash

        return task_hash(self)

    # --- starts, observations and rewards ---------------------------------------------------------------

    @cached_property
    def target_size(self) -> int:
        """Numbers in a target; 0 for a task without targets."""
        if self.draw_targets is None:
            return 0
        return self.draw_targets(1, np.random.default_rng(0)).shape[1]

    @cached_property
    def sin_cos_columns(self) -> tuple[int, ...]:
        """Columns of the state whose sine and cosine the `trig` observation appends."""
        return self.space.circular_columns if self.trig_columns is None else self.trig_columns

    @property
    def state_names(self) -> tuple[str, ...]:
        """Name of each number of a state."""
        return self.space.names

    @property
    def state_units(self) -> tuple[str, ...]:
        """Unit of each number of a state."""
        return self.space.units

    @property
    def obs_types(self) -> tuple[ObservationType, ...]:
        """The observation types that the task has."""
        return OBSERVATION_TYPES

    @property
    def reward_types(self) -> tuple[RewardType, ...]:
        """The reward types that the task has."""
        return ("dense", "sparse") if self.reward_2020 is None else ("dense", "sparse", "2020")

    def sample_starts(
        self, num: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "env state"], Float[np.ndarray, "env target"]]:
        """Draw the first states and the targets of `num` episodes; quaternions are normalised."""
        if self.draw_starts is None:
            states = rng.uniform(self.start_low, self.start_high, (num, len(self.start_low)))
        else:
            states = self.draw_starts(num, rng)
        states = self.space.normalise(states)
        targets = np.empty((num, 0)) if self.draw_targets is None else self.draw_targets(num, rng)
        return states, targets

    def observe_as(
        self,
        obs_type: ObservationType,
        states: Float[np.ndarray, "env state"],
        targets: Float[np.ndarray, "env target"],
    ) -> Float[np.ndarray, "env obs"]:
        """Return the observations of one type."""
        if obs_type == "wrapped" and (columns := self.space.circular_columns):
            states = states.copy()
            states[:, columns] = wrap(states[:, columns])
        raw = self.observe(states, targets)
        if obs_type != "trig":
            return raw
        angles = states[:, self.sin_cos_columns]
        return np.concatenate([raw, np.sin(angles), np.cos(angles)], axis=1)

    def reward_as(
        self,
        reward_type: RewardType,
        before: Float[np.ndarray, "env state"],
        after: Float[np.ndarray, "env state"],
        control: Float[np.ndarray, "env control"],
        targets: Float[np.ndarray, "env target"],
    ) -> Float[np.ndarray, " env"]:
        """Return the rewards of one type."""
        if reward_type == "sparse":
            return self.at_goal(after, targets).astype(float)
        if reward_type == "2020" and self.reward_2020 is not None:
            return self.reward_2020(before, after, control, targets)
        return self.reward(before, after, control, targets)

    def fields(self, obs_type: ObservationType) -> dict[str, str]:
        """Return the name and unit of each number of an observation, in order."""
        known = dict(self._raw_fields)
        if obs_type == "trig":
            angles = [self.space.names[column] for column in self.sin_cos_columns]
            known |= {f"{function}_{angle}": "" for function in ("sin", "cos") for angle in angles}
        return known

    @cached_property
    def _raw_fields(self) -> tuple[tuple[str, str], ...]:
        if self.obs_fields:
            return self.obs_fields
        if self.observe is states_only:
            return tuple(zip(self.space.names, self.space.units, strict=True))
        shape = self.observe(*self.sample_starts(1, np.random.default_rng(0))).shape
        return tuple((f"obs_{i}", "") for i in range(shape[-1]))


def find_reward_type(name: str, task: Task) -> RewardType:
    """Return the reward type with this name.

    Raises:
        UsageError: the task has no reward type with this name.
    """
    return find_name(f"reward type of {task.name}", name, task.reward_types)


def check_fields(task: Task) -> None:
    """Check what can be checked without compiling the model.

    Raises:
        UsageError: a value does not fit.
    """
    if not isinstance(task.name, str) or not re.fullmatch(r"(dmc:)?[\w.-]+", task.name):
        raise misfit(task, "name", f"must be letters, digits, '-', '_' and '.', got {quoted(task.name)}")
    joints = task.joints
    if not isinstance(joints, tuple) or not joints or not all(isinstance(joint, str) for joint in joints):
        raise misfit(task, "joints", f"must be a list of one joint name or more, got {quoted(joints)}")
    for name in ("horizon", "frame_skip", "action_repeat"):
        value = getattr(task, name)
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise misfit(task, name, f"must be a whole number of at least 1, got {quoted(value)}")
    low, high = _numbers(task, "start_low"), _numbers(task, "start_high")
    if low.shape != high.shape or (low > high).any():
        bounds = f"{quoted(task.start_low)} and {quoted(task.start_high)}"
        problem = f"must have as many numbers as start_high and none above it, got {bounds}"
        raise misfit(task, "start_low", problem)
    for name in ("reward", "at_goal", "observe", "terminated", *OPTIONAL):
        value = getattr(task, name)
        if not callable(value) and not (value is None and name in OPTIONAL):
            raise misfit(task, name, f"must be a function, got {quoted(value)}")
    if not isinstance(task.problem, str | Path) and not hasattr(task.problem, "compile"):
        raise misfit(task, "problem", f"must be a name, a path or a Problem, got {quoted(task.problem)}")


def misfit(task: Task, field: str, problem: str) -> UsageError:
    """Build the error for a field of a task, to be raised by the caller."""
    return UsageError(f"task {quoted(task.name)}: {field} {problem}. See {PAGE}.")


def _tuple(values: Sequence[Any] | np.ndarray, *, numbers: bool) -> tuple[Any, ...]:
    """A sequence as a tuple: of floats if they are to be numbers, and of tuples if it holds lists."""
    if numbers and all(isinstance(value, int | np.number) for value in values):
        return tuple(float(value) for value in values)
    return tuple(tuple(value) if isinstance(value, list) else value for value in values)


def _numbers(task: Task, field: str) -> np.ndarray:
    value = getattr(task, field)
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if numbers.ndim != 1 or not np.isfinite(numbers).all():
        raise misfit(task, field, f"must be a list of finite numbers, got {quoted(value)}")
    return numbers
