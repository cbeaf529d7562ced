"""Episodes of a task that are stepped together, for the training of policies."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.envs.batch import TaskBatch
from planspace.envs.gymnasium_groups import Group, LocalGroup, WorkerGroup
from planspace.tasks.gymnasium import AnyTask, GymTask
from planspace.tasks.observation_types import RewardType
from planspace.tasks.task import Task

NUM_SEEDS = 2**31
"""Seeds of Gymnasium environments are drawn below this number."""


class Steps(NamedTuple):
    """The result of one step in every episode."""

    rewards: Float[np.ndarray, " env"]
    terminated: Bool[np.ndarray, " env"]
    timeout: Bool[np.ndarray, " env"]
    """Whether the episode reached its time limit."""
    cut: Bool[np.ndarray, " env"]
    """Whether the episode cannot go on, because its physics diverged."""


@runtime_checkable
class Episodes(Protocol):
    """Episodes of a task for all seeds: the environments of a seed follow one another.

    What happens in an environment depends only on the random stream of its seed and on its own actions.
    """

    @property
    def task(self) -> AnyTask:
        """The task."""
        ...

    @property
    def states(self) -> Float[np.ndarray, "env state"]:
        """The current state of each episode. A step makes a new array."""
        ...

    @property
    def targets(self) -> Float[np.ndarray, "env target"]:
        """The target of each episode; no columns for a task without targets."""
        ...

    @property
    def action_limits(self) -> tuple[Float[np.ndarray, " action"], Float[np.ndarray, " action"]]:
        """Lower and upper limits of an action."""
        ...

    def reset(
        self, rngs: Sequence[np.random.Generator], ended: Bool[np.ndarray, "seed env"] | None = None
    ) -> None:
        """Start every episode, or those that ended.

        Args:
            rngs: the random stream of each seed.
            ended: the environments whose episodes start; None starts all.
        """
        ...

    def start_at(self, ids: Int[np.ndarray, " chosen"], values: Float[np.ndarray, "chosen settable"]) -> None:
        """Have some episodes, which have just started, start at other states, with the same targets.

        Args:
            ids: the environments.
            values: the numbers of the state that can be set: those of a planspace task, or of a Gymnasium
                environment the numbers `task.sizes.settable_names`.
        """
        ...

    def step(self, actions: Float[np.ndarray, "env action"]) -> Steps:
        """Take one step in every episode, with the actions clipped to their limits."""
        ...

    def close(self) -> None:
        """Free what the environments hold."""
        ...


def make_episodes(task: AnyTask, num: int, reward: RewardType = "dense", workers: int = 0) -> Episodes:
    """Make the environments for `num` episodes of a task, of all seeds together.

    Args:
        task: the task.
        num: number of episodes.
        reward: the reward type.
        workers: number of processes that step a Gymnasium environment; 0 steps them in this process.
    """
    if isinstance(task, GymTask):
        return GymEpisodes(task, num, workers)
    return TaskEpisodes(task, num, reward)


class TaskEpisodes:
    """Episodes of a planspace task, in one batch of simulations."""

    def __init__(self, task: Task, num: int, reward: RewardType = "dense"):
        """Start the simulations; `reset` starts the episodes.

        Args:
            task: the task; one that does not fit its model is refused (see `check_task`).
            num: number of episodes.
            reward: the reward type.
        """
        self.task = task
        self.batch = TaskBatch(task, num, reward=reward)
        self._elapsed = np.zeros(num, int)

    @property
    def states(self) -> Float[np.ndarray, "env state"]:
        """The current state of each episode."""
        return self.batch.states

    @property
    def targets(self) -> Float[np.ndarray, "env target"]:
        """The target of each episode."""
        return self.batch.targets

    @property
    def action_limits(self) -> tuple[Float[np.ndarray, " action"], Float[np.ndarray, " action"]]:
        """Lower and upper limits of the controls."""
        return self.batch.simulator.control_low, self.batch.simulator.control_high

    def reset(
        self, rngs: Sequence[np.random.Generator], ended: Bool[np.ndarray, "seed env"] | None = None
    ) -> None:
        """Start every episode, or those that ended, at states drawn from the task."""
        ids = None if ended is None else np.flatnonzero(ended).astype(np.int32)
        counts = [len(self.states) // len(rngs)] * len(rngs) if ended is None else ended.sum(axis=1)
        starts = [self.task.sample_starts(int(n), rng) for n, rng in zip(counts, rngs, strict=True)]
        states, targets = (np.concatenate(part) for part in zip(*starts, strict=True))
        self.batch.reset(states, targets, ids)
        self._elapsed[slice(None) if ids is None else ids] = 0

    def start_at(self, ids: Int[np.ndarray, " chosen"], values: Float[np.ndarray, "chosen settable"]) -> None:
        """Have some episodes, which have just started, start at other states, with the same targets."""
        self.batch.reset(values, self.targets[ids], ids.astype(np.int32))

    def step(self, actions: Float[np.ndarray, "env action"]) -> Steps:
        """Take one step in every episode."""
        rewards, terminated, diverged = self.batch.step(actions)
        self._elapsed += 1
        return Steps(rewards, terminated, ~terminated & (self._elapsed >= self.task.horizon), diverged)

    def close(self) -> None:
        """Do nothing: there is nothing to free."""


class GymEpisodes:
    """Episodes of a Gymnasium environment, which are stepped one after another or in worker processes."""

    def __init__(self, task: GymTask, num: int, workers: int = 0):
        """Make the environments; `reset` starts the episodes.

        Args:
            task: the task.
            num: number of environments.
            workers: number of processes that step them; 0 steps them in this process.
        """
        self.task = task
        self._group: Group = WorkerGroup(task, num, workers) if workers else LocalGroup(task, num)
        self.states = np.zeros((num, len(task.state_names)))
        self.targets = np.zeros((num, 0))

    @property
    def action_limits(self) -> tuple[Float[np.ndarray, " action"], Float[np.ndarray, " action"]]:
        """Lower and upper limits of the actions."""
        return self.task.sizes.action_low, self.task.sizes.action_high

    def reset(
        self, rngs: Sequence[np.random.Generator], ended: Bool[np.ndarray, "seed env"] | None = None
    ) -> None:
        """Start every episode, or those that ended, each with a seed drawn from its stream."""
        by_seed = np.arange(len(self.states)).reshape(len(rngs), -1)
        ids = [by_seed[s] if ended is None else by_seed[s][ended[s]] for s in range(len(rngs))]
        seeds = [rng.integers(NUM_SEEDS, size=len(i)) for i, rng in zip(ids, rngs, strict=True)]
        started = np.concatenate(ids)
        self.states[started] = self._group.reset(started, np.concatenate(seeds))

    def start_at(self, ids: Int[np.ndarray, " chosen"], values: Float[np.ndarray, "chosen settable"]) -> None:
        """Have some episodes, which have just started, start at other states."""
        self.states[ids] = self._group.set_states(ids, values)

    def step(self, actions: Float[np.ndarray, "env action"]) -> Steps:
        """Take one step in every episode; one whose action is not finite is cut before the step."""
        rewards = np.zeros(len(actions))
        terminated, truncated = np.zeros((2, len(actions)), bool)
        can_act, states = np.isfinite(actions).all(axis=1), self.states.copy()
        ids = np.flatnonzero(can_act)
        states[ids], rewards[ids], terminated[ids], truncated[ids] = self._group.step(ids, actions[ids])
        self.states = states
        return Steps(rewards, terminated, truncated & ~terminated, np.logical_not(can_act))

    def close(self) -> None:
        """Close the environments."""
        self._group.close()
