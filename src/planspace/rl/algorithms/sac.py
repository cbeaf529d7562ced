"""Soft actor-critic (Haarnoja et al. 2018), with the temperature adjusted as in its second version."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from planspace.errors import check_layers, check_setting
from planspace.rl.algorithm import Arm, Key, PolicyNetwork, Rollout


@dataclass(frozen=True)
class SAC:
    """Soft actor-critic; the defaults are those of Stable-Baselines3."""

    name: ClassVar[str] = "sac"
    clones: ClassVar[bool] = True
    replays: ClassVar[bool] = True
    batch_steps: ClassVar[int] = 1000
    """Environment steps per iteration, unless the settings of the run give another number."""

    discount: float = 0.99
    """Discount factor gamma."""
    hidden: tuple[int, ...] = (256, 256)
    """Units of the policy's hidden layers."""
    critic_hidden: tuple[int, ...] = (256, 256)
    """Units of the hidden layers of each of the two critics."""
    layer_norm: bool = False
    """Normalise the hidden layers of the critics."""
    normalise_obs: bool = False
    """Standardise observations by the mean and standard deviation that each seed has seen so far."""
    learning_rate: float = 3e-4
    """Learning rate of Adam for policy, critics and temperature."""
    batch: int = 256
    """Steps drawn from the replay for each gradient step."""
    updates_per_step: float = 1.0
    """Gradient steps per environment step. They follow the episodes of an iteration."""
    learning_starts: int = 100
    """Environment steps with uniformly random actions, before the first gradient step."""
    replay_size: int = 1_000_000
    """Steps that the replay holds; then the oldest are replaced."""
    polyak: float = 0.005
    """Fraction by which the target critics approach the critics in a gradient step."""
    temperature: float = 1.0
    """First temperature: the worth of a nat of the policy's entropy. It is then adjusted."""
    target_entropy: float | None = None
    """Entropy of the policy to which the temperature is adjusted [nat]; by default, minus the numbers in an
    action."""

    @property
    def steps_a_second(self) -> float:
        """Environment steps that one core trains in a second, roughly."""
        width = max(1, *self.hidden, *self.critic_hidden)
        return 100 * (256 / width) ** 1.4 / max(self.updates_per_step, 0.1)

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: a hyper-parameter is out of its range.
        """
        check_layers("hidden", self.hidden)
        check_layers("critic_hidden", self.critic_hidden)
        check_setting("discount", self.discount, 0 <= self.discount <= 1, "between 0 and 1")
        check_setting("polyak", self.polyak, 0 < self.polyak <= 1, "above 0 and at most 1")
        for name in ("learning_rate", "temperature", "updates_per_step"):
            value = getattr(self, name)
            check_setting(name, value, 0 < value < math.inf, "above 0 and finite")
        for name in ("batch", "replay_size"):
            check_setting(name, getattr(self, name), getattr(self, name) >= 1, "at least 1")
        check_setting("learning_starts", self.learning_starts, self.learning_starts >= 0, "at least 0")
        target = self.target_entropy
        check_setting("target_entropy", target, target is None or math.isfinite(target), "finite")

    def init(self, arm: Arm, *, key: Key) -> Any:
        """Return fresh networks and an empty replay.

        Raises:
            UsageError: an action has no limits.
        """
        from planspace.rl.sac_agent import new_state

        return new_state(self, arm, key=key)

    def clone(self, arm: Arm, state: Any, *, key: Key) -> Any:
        """Take gradient steps that bring the mean action to the controls of plans."""
        from planspace.rl.sac_agent import clone

        return clone(self, arm, state, key=key)

    def collect(self, arm: Arm, states: Sequence[Any], rngs: Sequence[np.random.Generator]) -> Rollout:
        """Play episodes with actions drawn from the policies; the first actions are uniformly random."""
        from planspace.rl.sac_agent import collect

        return collect(self, arm, states, rngs)

    def update(self, arm: Arm, state: Any, rollout: Rollout, *, key: Key) -> tuple[Any, Mapping[str, float]]:
        """Put the steps into the replay, and take gradient steps on batches drawn from it."""
        from planspace.rl.sac_agent import update

        return update(self, arm, state, rollout, key=key)

    def act(self, arm: Arm, state: Any) -> PolicyNetwork:
        """Return the network of the mean, squashed between the limits of an action."""
        from planspace.rl.sac_agent import act

        return act(self, arm, state)
