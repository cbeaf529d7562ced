"""What an algorithm trains on: the environments of all seeds, and their observations and their rewards."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planspace.envs.episodes import Episodes
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.rollout import ActFn, Rollout, collect
from planspace.rl.shaping import Shaping
from planspace.rl.transitions import Transitions
from planspace.tasks.gymnasium import AnyTask


@dataclass(frozen=True)
class Arm:
    """A task as an algorithm sees it, with the environments of all seeds; it does not change in training."""

    config: TrainConfig
    """The settings of the run."""
    observer: Observer
    """What policy and critic observe."""
    episodes: Episodes
    """The environments, seed by seed, the same number for each seed. A fraction of the episodes may start at
    states of plans."""
    shaping: Shaping | None = None
    """The shaping reward, if there is any."""
    plan_transitions: Transitions | None = None
    """Transitions along plans, the same for each seed; None unless `config.replay` is above 0."""

    @property
    def task(self) -> AnyTask:
        """The task."""
        return self.episodes.task

    @property
    def num_envs(self) -> int:
        """Environments per seed."""
        return len(self.episodes.states) // self.config.num_seeds

    @property
    def steps(self) -> int:
        """Steps per iteration and seed: one episode of full length in each environment."""
        return self.num_envs * self.task.horizon

    @property
    def num_actions(self) -> int:
        """Numbers in an action."""
        return len(self.episodes.action_limits[0])

    @property
    def num_policy_obs(self) -> int:
        """Numbers that the policy observes; they are the columns `observer.policy_columns`."""
        return self.observer.num_policy_obs

    def rollout(
        self,
        act: ActFn,
        rngs: Sequence[np.random.Generator],
        *,
        discount: float = 1.0,
        bootstrap_timeout: bool = False,
    ) -> Rollout:
        """Play fresh episodes in every environment, for as many steps as an episode lasts at most.

        Args:
            act: (observations [seed, env, obs], unit Gaussian noise [seed, env, action]) to the actions
                [seed, env, action]. The noise comes from `rngs`; use it to explore, so that a seed's actions
                do not depend on other seeds.
            rngs: the random stream of each seed.
            discount: the algorithm's discount factor; the shaping reward depends on it.
            bootstrap_timeout: whether the algorithm counts the value of the state at the time limit; the
                shaping reward depends on it.
        """
        shape = None if self.shaping is None else self.shaping.reward_fn(discount, bootstrap_timeout)
        return collect(self.episodes, self.observer, act, self.task.horizon, rngs, shape=shape)
