"""Potential-based shaping: a reward for approaching the goal that does not change the optimal policy.

With Phi(x) = -scale d(x, goal) / d_0, the reward of a step grows by gamma Phi(x') - Phi(x) (Ng, Harada and
Russell 1999). d_0 is the mean distance of the task's starts, so that different distances have the same scale.
With the shaping `time`, d is the embedding's time to go. Tabular Q-learning that is shaped by Phi makes the
same updates as without shaping from the first values Phi (Wiewiora 2003), here minus the time to go.
`PlanSpaceShaping` does this for one environment, this module for all seeds at once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from planspace.embed.embedding import Embedding, norm
from planspace.errors import UsageError
from planspace.physics.space import StateSpace
from planspace.rl.config import TrainConfig
from planspace.rl.rollout import ShapeFn
from planspace.rl.task_goal import fixed_goal
from planspace.tasks.gymnasium import AnyTask
from planspace.tasks.task import Task

NUM_STARTS = 1000
"""Number of starts over which d_0 is a mean."""


@dataclass(frozen=True)
class Shaping:
    """The potential of an arm, from which its shaping reward follows."""

    task: Task
    distances: tuple[Callable[[np.ndarray], np.ndarray], ...]
    """States to their distance from the goal: one for all seeds, or one for each."""
    num_seeds: int
    """Seeds, whose environments follow one another; the reward of a seed does not depend on the others."""
    scale: float
    """Return from a mean start to the goal."""

    @classmethod
    def of(cls, config: TrainConfig, task: AnyTask, embeddings: tuple[Embedding, ...]) -> "Shaping | None":
        """The shaping of an arm, if it has any.

        Args:
            config: the settings.
            task: the task.
            embeddings: the embeddings that make z: one for all seeds, or one for each.

        Raises:
            UsageError: the task has no fixed goal, shaping by z or by time has no embedding, or the embedding
                has no time head.
        """
        if config.shaping == "none":
            return None
        goal = fixed_goal(task, "--shaping")
        assert isinstance(task, Task)
        space = task.space
        if config.shaping == "raw":

            def distance(states: np.ndarray) -> np.ndarray:
                return norm(space.difference(states, goal.center) * goal.weights)

            distances = (distance,)
        elif embeddings:
            measure = _distance_in_z if config.shaping == "z" else _time_to_go
            distances = tuple(measure(each, space, goal.center) for each in embeddings)
        else:
            raise UsageError(f"shaping by {config.shaping!r} needs an embedding: give --embedding DIR.")
        return cls(task, distances, config.num_seeds, config.shaping_scale)

    def reward_fn(self, discount: float, bootstrap_timeout: bool) -> ShapeFn:
        """The shaping reward of a step for an algorithm.

        An episode that terminates ends at potential 0. One that reaches the time limit ends at potential 0
        if the algorithm counts nothing beyond it, and otherwise at the potential of its last state.

        Args:
            discount: the algorithm's discount factor.
            bootstrap_timeout: whether it counts the value of the state at the time limit.

        Returns:
            (states before and after [env, state], terminated [env], at the time limit [env]) to the reward
            [env], the environments of a seed one after another.
        """

        def reward(
            before: Float[np.ndarray, "env state"],
            after: Float[np.ndarray, "env state"],
            terminated: Bool[np.ndarray, " env"],
            timeout: Bool[np.ndarray, " env"],
        ) -> Float[np.ndarray, " env"]:
            ended = terminated if bootstrap_timeout else terminated | timeout
            return np.where(ended, 0.0, discount * self._potential(after)) - self._potential(before)

        return reward

    def _potential(self, states: Float[np.ndarray, "env state"]) -> Float[np.ndarray, " env"]:
        by_seed = states.reshape(self.num_seeds, -1, states.shape[-1])
        groups = [by_seed] if len(self.distances) == 1 else list(by_seed[:, None])
        parts = zip(self.distances, groups, self._typical, strict=True)
        return np.concatenate([(-self.scale / d_0 * distance(x)).ravel() for distance, x, d_0 in parts])

    @cached_property
    def _typical(self) -> list[float]:
        """d_0 of each distance."""
        starts, _ = self.task.sample_starts(NUM_STARTS, np.random.default_rng(0))
        return [float(distance(starts).mean()) for distance in self.distances]


def _distance_in_z(
    embedding: Embedding, space: StateSpace, goal: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    columns = list(embedding.columns_of(space.names, space.units))
    z_goal = embedding.encode(goal[columns])

    def distance(states: np.ndarray) -> np.ndarray:
        return norm(embedding.encode(states[..., columns]) - z_goal)

    return distance


def _time_to_go(
    embedding: Embedding, space: StateSpace, goal: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    if embedding.time_head is None:
        raise UsageError(
            "shaping by 'time' needs an embedding with a time head: train it with `planspace embed "
            "--time-head` and give --embedding DIR."
        )
    columns = list(embedding.columns_of(space.names, space.units))

    def distance(states: np.ndarray) -> np.ndarray:
        return np.asarray(embedding.time_to_go(states[..., columns], goal[columns]), float)

    return distance
