"""What an algorithm trains on: the environments of all seeds, their observations and their rewards."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planspace.envs.episodes import Episodes
from planspace.envs.plan_starts import PlanStarts
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.progress import Progress
from planspace.rl.rollout import ActFn, Rollout, ShapeFn, collect
from planspace.rl.shaping import Shaping
from planspace.rl.transitions import Transitions
from planspace.tasks.gymnasium import AnyTask


@dataclass(frozen=True)
class Arm:
    """A task as an algorithm sees it, with the environments of all seeds.

    In training, only `done` changes, and with it the states at which episodes start.
    """

    config: TrainConfig
    """The settings of the run."""
    observer: Observer
    """What policy and critic observe."""
    episodes: Episodes
    """The environments, seed by seed, the same number for each seed. A fraction of the episodes may start at
    states of plans."""
    shaping: Shaping | None = None
    """The shaping reward, if there is any."""
    progress: Progress | None = None
    """The reward that is paid instead of the task's, if it is `progress`."""
    plan_transitions: Transitions | None = None
    """Transitions along plans and, with `plan_noise`, beside them, the same for each seed; None unless
    `config` has `replay`, `clone` or `clone_weight`."""
    done: float = 0.0
    """Fraction of training that is done."""

    def at(self, done: float) -> "Arm":
        """The arm when this fraction of training is done."""
        episodes = self.episodes
        moved = episodes.at(done) if isinstance(episodes, PlanStarts) else episodes
        return replace(self, episodes=moved, done=done)

    @property
    def clone_weight(self) -> float:
        """Weight of the penalty for actions that differ from the controls of plans, at present."""
        return self.config.clone_weight * max(0.0, 1.0 - self.done / self.config.clone_decay)

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
        """Actions per iteration and seed: one episode of full length in each environment."""
        return self.num_envs * self.task.horizon

    @property
    def env_steps(self) -> int:
        """Environment steps per iteration and seed; an action lasts `config.action_repeat` of them."""
        return self.steps * self.config.action_repeat

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
        shape = self._shape_fn(discount, bootstrap_timeout)
        rollout = collect(self.episodes, self.observer, act, self.task.horizon, rngs, shape=shape)
        if self.progress is not None:  # `rewards + shaping` is paid; returns are the task's
            rollout.shaping[:] -= rollout.rewards
        return rollout

    def _shape_fn(self, discount: float, bootstrap_timeout: bool) -> ShapeFn | None:
        progress, episodes = self.progress, self.episodes
        if progress is not None:
            return lambda before, after, terminated, timeout: progress(before, after, episodes.targets)
        return None if self.shaping is None else self.shaping.reward_fn(discount, bootstrap_timeout)
