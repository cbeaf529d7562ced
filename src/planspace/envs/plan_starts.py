"""Episodes of which a fraction starts at states of plans."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.envs.episodes import Episodes, Steps
from planspace.tasks.gymnasium import AnyTask

FIRST_PART = 0.1
"""Last part of each plan in which episodes start at the beginning of a reverse curriculum."""
WHOLE_AFTER = 0.5
"""Fraction of training after which a reverse curriculum starts episodes anywhere on a plan."""


@dataclass(frozen=True)
class StartStates:
    """States at which episodes start."""

    states: Float[np.ndarray, "start state"]
    remaining: Float[np.ndarray, " start"] | None = None
    """Fraction of its plan that is left at each state, in ascending order, for a reverse curriculum: states
    with a small one come first in training. None draws from all states from the beginning."""

    def num_at(self, done: float) -> int:
        """Number of states, from the first on, from which starts are drawn.

        Args:
            done: fraction of training that is done.
        """
        if self.remaining is None:
            return len(self.states)
        part = FIRST_PART + (1.0 - FIRST_PART) * min(1.0, done / WHOLE_AFTER)
        return max(1, int(np.searchsorted(self.remaining, part, side="right")))


class PlanStarts:
    """Episodes of a task, of which a fraction starts at states of plans.

    A start at a state of a plan keeps the target that the task drew for the episode.
    """

    def __init__(self, own: Episodes, starts: StartStates, fraction: float, done: float = 0.0):
        """Draw starts from plans, too.

        Args:
            own: the episodes, which start as the task says.
            starts: the states of plans, from which starts are drawn uniformly.
            fraction: probability that an episode starts at one of them.
            done: fraction of training that is done.
        """
        self.own = own
        self._starts, self._fraction, self._num = starts, fraction, starts.num_at(done)

    def at(self, done: float) -> "PlanStarts":
        """The same environments when this fraction of training is done."""
        return PlanStarts(self.own, self._starts, self._fraction, done)

    @property
    def task(self) -> AnyTask:
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
        by_seed = np.arange(len(self.states)).reshape(len(rngs), -1)
        ids, rows = [], []
        for s, rng in enumerate(rngs):
            started = by_seed[s] if ended is None else by_seed[s][ended[s]]
            chosen = started[rng.random(len(started)) < self._fraction]
            ids.append(chosen)
            rows.append(rng.integers(self._num, size=len(chosen)))
        index = np.concatenate(ids)
        self.start_at(index, self._starts.states[np.concatenate(rows)])

    def start_at(self, ids: Int[np.ndarray, " chosen"], values: Float[np.ndarray, "chosen settable"]) -> None:
        """Have some episodes, which have just started, start at other states, with the same targets."""
        self.own.start_at(ids, values)

    def step(self, actions: Float[np.ndarray, "env action"]) -> Steps:
        """Take one step in every episode."""
        return self.own.step(actions)

    def close(self) -> None:
        """Free what the environments hold."""
        self.own.close()


def own_starts(episodes: Episodes) -> Episodes:
    """The same environments, whose episodes all start as the task says."""
    return episodes.own if isinstance(episodes, PlanStarts) else episodes
