"""Tasks whose state can be set: planspace's own, and Gymnasium environments that allow it."""

from functools import cached_property
from typing import NamedTuple, Protocol, runtime_checkable

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from planspace.envs.batch import TaskBatch
from planspace.envs.gymnasium_env import GymTaskEnv
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.progress import progress_over
from planspace.rl.task_goal import has_goal_states
from planspace.tasks.env_state import mujoco_of
from planspace.tasks.gymnasium import AnyTask, GymTask
from planspace.tasks.observation_types import RewardType
from planspace.tasks.task import Task

BLOCK = 256
"""States that are simulated or judged at once; results do not depend on it."""


class SetSteps(NamedTuple):
    """One step of a task from each of several states."""

    before: Float[np.ndarray, "step state"]
    """The states of the task that were set."""
    rewards: Float[np.ndarray, " step"]
    after: Float[np.ndarray, "step state"]
    terminated: Bool[np.ndarray, " step"]
    diverged: Bool[np.ndarray, " step"]
    """Whether the physics diverged, so that the step does not count."""


@runtime_checkable
class Settable(Protocol):
    """A task whose state can be set."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each number that is set."""
        ...

    @property
    def limits(self) -> tuple[Float[np.ndarray, " control"], Float[np.ndarray, " control"]]:
        """Lower and upper limits of the controls."""
        ...

    @property
    def duration(self) -> float:
        """Duration of a step [s]."""
        ...

    @property
    def space(self) -> StateSpace | None:
        """The space of the joints, whose numbers come first; None if no joints are known."""
        ...

    def normalise(self, values: Float[np.ndarray, "row settable"]) -> Float[np.ndarray, "row settable"]:
        """The same states as the task has them."""
        ...

    def goes_on(self, values: Float[np.ndarray, "row settable"]) -> Bool[np.ndarray, " row"]:
        """Whether an episode goes on at each of these states, as far as is known before a step."""
        ...

    def targets(self, goals: Float[np.ndarray, "row settable"]) -> Float[np.ndarray, "row target"]:
        """The targets of episodes with these goals, or drawn ones if the task's targets are no states."""
        ...

    def step(
        self,
        values: Float[np.ndarray, "step settable"],
        actions: Float[np.ndarray, "step control"],
        targets: Float[np.ndarray, "step target"],
    ) -> SetSteps:
        """Take one step from each of these states."""
        ...


def find_settable(task: AnyTask, reward: RewardType) -> Settable | None:
    """Return what sets the state of a task; None if that cannot be done.

    Args:
        task: the task.
        reward: the reward type of the steps.
    """
    if isinstance(task, Task):
        return SettableTask(task, reward)
    return SettableGym(task) if task.sizes.settable_names else None


class SettableTask:
    """A planspace task, in one batch of simulations."""

    def __init__(self, task: Task, reward: RewardType):
        """Steps of a task with a reward type."""
        self.task = task
        self._reward: RewardType = reward

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the planning state."""
        return self.task.state_names

    @property
    def limits(self) -> tuple[Float[np.ndarray, " control"], Float[np.ndarray, " control"]]:
        """Lower and upper limits of the controls."""
        return self._batch.simulator.control_low, self._batch.simulator.control_high

    @property
    def duration(self) -> float:
        """Duration of a step [s]."""
        return self.physics_steps * float(self._batch.simulator.model.opt.timestep)

    @property
    def space(self) -> StateSpace:
        """The state space of the task."""
        return self.task.space

    def normalise(self, values: Float[np.ndarray, "row state"]) -> Float[np.ndarray, "row state"]:
        """The same states with quaternions of length one."""
        return self.task.space.normalise(values)

    def goes_on(self, values: Float[np.ndarray, "row state"]) -> Bool[np.ndarray, " row"]:
        """Whether an episode goes on at each of these states."""
        blocks = range(0, len(values), BLOCK)
        return ~np.concatenate([self.task.terminated(values[first : first + BLOCK]) for first in blocks])

    def targets(self, goals: Float[np.ndarray, "row state"]) -> Float[np.ndarray, "row target"]:
        """The goals, or targets that the task draws if its targets are no states."""
        if has_goal_states(self.task):
            return self.task.space.normalise(goals)
        return self.task.sample_starts(len(goals), np.random.default_rng(0))[1]

    def step(
        self,
        values: Float[np.ndarray, "step state"],
        actions: Float[np.ndarray, "step control"],
        targets: Float[np.ndarray, "step target"],
    ) -> SetSteps:
        """Take one step from each of these states."""
        parts, batch = [], self._batch
        blocks = range(0, len(values), BLOCK)
        for first in progress_over(blocks, "steps of plans", unit="block", total=len(blocks)):
            rows = np.minimum(np.arange(first, first + BLOCK), len(values) - 1)  # the last is repeated
            batch.reset(values[rows], targets[rows])
            before = batch.states.copy()
            rewards, terminated, diverged = batch.step(actions[rows])
            found = SetSteps(before, rewards, batch.states.copy(), terminated, diverged)
            parts.append([array[: len(values) - first] for array in found])
        return SetSteps(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    @property
    def simulator(self) -> Simulator:
        """The simulations, which every call overwrites."""
        return self._batch.simulator

    @property
    def physics_steps(self) -> int:
        """Physics steps in a step of the task."""
        return self.task.action_repeat * self.task.frame_skip

    @cached_property
    def _batch(self) -> TaskBatch:
        return TaskBatch(self.task, BLOCK, reward=self._reward)


class SettableGym:
    """A Gymnasium environment whose state can be set, which takes one step after another."""

    def __init__(self, task: GymTask):
        """Steps of an environment."""
        self.task = task

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers that determine its state."""
        return self.task.sizes.settable_names

    @property
    def limits(self) -> tuple[Float[np.ndarray, " control"], Float[np.ndarray, " control"]]:
        """Lower and upper limits of the actions."""
        return self.task.sizes.action_low, self.task.sizes.action_high

    @property
    def duration(self) -> float:
        """Duration of a step [s]."""
        return self._env.step_time

    @property
    def space(self) -> StateSpace | None:
        """The space of the MuJoCo joints; None if the environment has a state of its own."""
        return self._env.joint_space

    @cached_property
    def driven(self) -> Bool[np.ndarray, " tangent"]:
        """Which numbers of a tangent are of joints with a position servo; none if any actuator is another."""
        found, space = mujoco_of(self._env.inner), self.space
        if space is None or found is None:
            return np.zeros(0, bool)
        model = found[0]
        of_joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        feedback = model.actuator_biasprm[:, 1]  # force for each metre or radian
        servos = of_joints & (feedback < 0) & (model.actuator_dyntype != mujoco.mjtDyn.mjDYN_INTEGRATOR)
        dofs = model.jnt_dofadr[model.actuator_trnid[servos, 0]]
        driven = np.isin(space.qvel_index, dofs) & servos.all()
        return np.concatenate([driven, driven, np.zeros(space.num_activations, bool)])

    def normalise(self, values: Float[np.ndarray, "row settable"]) -> Float[np.ndarray, "row settable"]:
        """The same states."""
        return values

    def goes_on(self, values: Float[np.ndarray, "row settable"]) -> Bool[np.ndarray, " row"]:
        """Say that every episode goes on: an environment tells only after a step."""
        return np.ones(len(values), bool)

    def targets(self, goals: Float[np.ndarray, "row settable"]) -> Float[np.ndarray, "row 0"]:
        """No targets: an environment keeps its own."""
        return np.zeros((len(goals), 0))

    def step(
        self,
        values: Float[np.ndarray, "step settable"],
        actions: Float[np.ndarray, "step control"],
        targets: Float[np.ndarray, "step target"],
    ) -> SetSteps:
        """Take one step from each of these states."""
        env, parts = self._env, []
        rows = zip(values, actions, strict=True)
        for state, action in progress_over(rows, "steps of plans", unit="step", total=len(values)):
            env.reset(seed=0)
            env.set_state(state)
            before = env.state.copy()
            _, reward, terminated, _, _ = env.step(action)
            parts.append((before, reward, env.state.copy(), terminated, False))
        return SetSteps(*(np.array(column) for column in zip(*parts, strict=True)))

    @cached_property
    def _env(self) -> GymTaskEnv:
        return GymTaskEnv(self.task)
