"""Episodes of which a fraction starts at states of plans."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from planspace.envs.episodes import Episodes, Steps, TaskEpisodes
from planspace.tasks.task import Task


class PlanStarts:
    """Episodes of a task, of which a fraction starts at states of plans.

    A start at a state of a plan keeps the target that the task drew for the episode.
    """

    def __init__(self, own: TaskEpisodes, states: Float[np.ndarray, "start state"], fraction: float):
        """Draw starts from plans, too.

        Args:
            own: the episodes, which start as the task says.
            states: the states of plans, from which starts are drawn uniformly.
            fraction: probability that an episode starts at one of them.
        """
        self.own = own
        self._starts, self._fraction = states, fraction

    @property
    def task(self) -> Task:
        """The task."""
        return self.own.task

    @property
    def states(self) -> Float[np.ndarray, "env state"]:
        """The current state of each episode."""
        return self.own.states

    @property
    def targets(self) -> Float[np.ndarray, "env target"]:
        """The target of each episode."""
        return self.own.targets

    @property
    def action_limits(self) -> tuple[Float[np.ndarray, " action"], Float[np.ndarray, " action"]]:
        """Lower and upper limits of the controls."""
        return self.own.action_limits

    def reset(
        self, rngs: Sequence[np.random.Generator], ended: Bool[np.ndarray, "seed env"] | None = None
    ) -> None:
        """Start every episode, or those that ended, each as the task says or at a state of a plan."""
        self.own.reset(rngs, ended)
        by_seed = np.arange(len(self.states), dtype=np.int32).reshape(len(rngs), -1)
        ids, rows = [], []
        for s, rng in enumerate(rngs):
            started = by_seed[s] if ended is None else by_seed[s][ended[s]]
            chosen = started[rng.random(len(started)) < self._fraction]
            ids.append(chosen)
            rows.append(rng.integers(len(self._starts), size=len(chosen)))
        index = np.concatenate(ids)
        self.own.batch.reset(self._starts[np.concatenate(rows)], self.targets[index], index)

    def step(self, actions: Float[np.ndarray, "env action"]) -> Steps:
        """Take one step in every episode."""
        return self.own.step(actions)

    def close(self) -> None:
        """Do nothing: there is nothing to free."""


def own_starts(episodes: Episodes) -> Episodes:
    """The same environments, whose episodes all start as the task says."""
    return episodes.own if isinstance(episodes, PlanStarts) else episodes
