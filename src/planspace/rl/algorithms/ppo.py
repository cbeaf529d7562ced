"""Proximal policy optimisation with a clipped ratio (Schulman et al. 2017)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from planspace.errors import check_setting
from planspace.rl.algorithm import Arm, Key, PolicyNetwork, Rollout
from planspace.rl.algorithms.on_policy import PPO_2020, OnPolicy


@dataclass(frozen=True)
class PPO:
    """Proximal policy optimisation; the defaults are the preset `paper`."""

    name: ClassVar[str] = "ppo"
    clones: ClassVar[bool] = True
    steps_a_second: ClassVar[float] = 37_000
    """Environment steps that one core trains in a second, roughly."""

    on_policy: OnPolicy = PPO_2020
    """Policy, critic and advantages."""
    clip: float = 0.2
    """Distance from 1 beyond which the probability ratio is clipped."""
    learning_rate: float = 1e-3
    """Learning rate of Adam."""
    epochs: int = 10
    """Passes over the samples of an iteration."""
    minibatch: int = 32
    """Trajectories a minibatch or, with `of_steps`, steps."""
    of_steps: bool = False
    """Draw minibatches of steps from all episodes instead of whole trajectories."""
    tolerance: float = 1e-6
    """Stop after an epoch that changes the loss by less than this; 0 never stops early."""
    clip_norm: float | None = None
    """Norm to which gradients are clipped; none by default."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: a hyper-parameter is out of its range.
        """
        for name in ("clip", "learning_rate", "clip_norm"):
            value = getattr(self, name)
            check_setting(name, value, value is None or 0 < value < math.inf, "above 0 and finite")
        for name in ("epochs", "minibatch"):
            check_setting(name, getattr(self, name), getattr(self, name) >= 1, "at least 1")
        check_setting("tolerance", self.tolerance, self.tolerance >= 0, "at least 0")

    def init(self, arm: Arm, *, key: Key) -> Any:
        """Return a fresh policy and critic, and the state of Adam."""
        from planspace.rl.agent import new_agent
        from planspace.rl.ppo_update import optimiser

        return new_agent(self.on_policy, arm, key=key, optimiser=optimiser(self))

    def clone(self, arm: Arm, state: Any, *, key: Key) -> Any:
        """Take gradient steps that bring the mean action to the controls of plans."""
        from planspace.rl.agent import clone

        return clone(self.on_policy, arm, state, key=key)

    def collect(self, arm: Arm, states: Sequence[Any], rngs: Sequence[np.random.Generator]) -> Rollout:
        """Play episodes with actions drawn from the policies."""
        from planspace.rl.agent import collect

        return collect(self.on_policy, arm, states, rngs)

    def update(self, arm: Arm, state: Any, rollout: Rollout, *, key: Key) -> tuple[Any, Mapping[str, float]]:
        """Take several epochs of minibatch steps, then fit the critic."""
        from planspace.rl.agent import update
        from planspace.rl.ppo_update import improve

        return update(self.on_policy, improve(self), arm, state, rollout, key=key)

    def act(self, arm: Arm, state: Any) -> PolicyNetwork:
        """Return the network of the mean action."""
        from planspace.rl.agent import act

        return act(self.on_policy, state)
