"""Evaluations: episodes without exploration, which all start as the task says."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from planspace.envs.episodes import Episodes
from planspace.rl.observe import Observer
from planspace.rl.rollout import ActFn, collect, first_episodes
from planspace.tasks.task import Task

EVALUATION_SEED = 20_201_026
"""Seed of the episodes: they start the same for every seed of every arm."""


class Evaluation(NamedTuple):
    """What each seed earned in an episode in each of its environments."""

    returns: Float[np.ndarray, " seed"]
    """Mean undiscounted return."""
    success: Float[np.ndarray, " seed"] | None
    """Fraction of the episodes that ended at the goal; None for Gymnasium environments, which do not say."""


def evaluate(episodes: Episodes, observer: Observer, act: ActFn, num_seeds: int) -> Evaluation:
    """Play one episode in each environment.

    Args:
        episodes: the environments of all seeds, seed by seed.
        observer: what the policies see.
        act: the actions of all seeds.
        num_seeds: number of seeds.
    """
    rngs = [np.random.default_rng(EVALUATION_SEED) for _ in range(num_seeds)]
    ends = _Ends(episodes)
    rollout = collect(episodes, observer, act, episodes.task.horizon, rngs, shape=ends)
    first = first_episodes(rollout)
    returns = np.where(first, rollout.rewards, 0.0).sum(axis=0).mean(axis=1)
    if not ends.at_goal:
        return Evaluation(returns, None)
    at_goal = np.stack(ends.at_goal).reshape(first.shape)
    return Evaluation(returns, (at_goal & first).any(axis=0).mean(axis=1))


class _Ends:
    """Watches the steps of a rollout as its shaping reward, of which it pays none."""

    def __init__(self, episodes: Episodes):
        self._episodes = episodes
        self.at_goal: list[Bool[np.ndarray, " env"]] = []
        """For each step, whether an episode ended there at the goal; empty if the task does not say."""

    def __call__(
        self, before: np.ndarray, after: np.ndarray, terminated: np.ndarray, timeout: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        task, ended = self._episodes.task, terminated | timeout
        if isinstance(task, Task):
            reached = task.at_goal(after, self._episodes.targets) if ended.any() else ended
            self.at_goal.append(np.asarray(reached, dtype=bool) & ended)
        return np.zeros(len(after))
