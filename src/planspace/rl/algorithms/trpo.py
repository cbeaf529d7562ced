"""Trust region policy optimisation (Schulman et al. 2015)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from planspace.errors import check_setting
from planspace.rl.algorithm import Arm, Key, PolicyNetwork, Rollout
from planspace.rl.algorithms.on_policy import TRPO_2020, OnPolicy


@dataclass(frozen=True)
class TRPO:
    """Trust region policy optimisation; the defaults are the preset `paper`."""

    name: ClassVar[str] = "trpo"
    clones: ClassVar[bool] = True
    steps_a_second: ClassVar[float] = 40_000
    """Environment steps that one core trains in a second, roughly."""

    on_policy: OnPolicy = TRPO_2020
    """Policy, critic and advantages."""
    max_kl: float = 0.01
    """Bound on the mean KL of an update [nat]."""
    cg_steps: int = 10
    """Conjugate gradient steps."""
    cg_damping: float = 1e-5
    """Added to the diagonal of the Fisher matrix."""
    backtrack_ratio: float = 0.8
    """Factor by which the line search shortens a rejected step."""
    max_backtracks: int = 15
    """Rejected steps after which the line search leaves the policy unchanged."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: a hyper-parameter is out of its range.
        """
        check_setting("max_kl", self.max_kl, 0 < self.max_kl < math.inf, "above 0 and finite")
        check_setting("cg_steps", self.cg_steps, self.cg_steps >= 1, "at least 1")
        check_setting("cg_damping", self.cg_damping, 0 <= self.cg_damping < math.inf, "at least 0 and finite")
        ratio = self.backtrack_ratio
        check_setting("backtrack_ratio", ratio, 0 < ratio < 1, "above 0 and below 1")
        check_setting("max_backtracks", self.max_backtracks, self.max_backtracks >= 0, "at least 0")

    def init(self, arm: Arm, *, key: Key) -> Any:
        """Return a fresh policy and critic."""
        from planspace.rl.agent import new_agent

        return new_agent(self.on_policy, arm, key=key)

    def clone(self, arm: Arm, state: Any, *, key: Key) -> Any:
        """Take gradient steps that bring the mean action to the controls of plans."""
        from planspace.rl.agent import clone

        return clone(self.on_policy, arm, state, key=key)

    def collect(self, arm: Arm, states: Sequence[Any], rngs: Sequence[np.random.Generator]) -> Rollout:
        """Play episodes with actions drawn from the policies."""
        from planspace.rl.agent import collect

        return collect(self.on_policy, arm, states, rngs)

    def update(self, arm: Arm, state: Any, rollout: Rollout, *, key: Key) -> tuple[Any, Mapping[str, float]]:
        """Take the largest step within the trust region, then fit the critic."""
        from planspace.rl.agent import update
        from planspace.rl.trpo_update import improve

        return update(self.on_policy, improve(self), arm, state, rollout, key=key)

    def act(self, arm: Arm, state: Any) -> PolicyNetwork:
        """Return the network of the mean action."""
        from planspace.rl.agent import act

        return act(self.on_policy, state)
