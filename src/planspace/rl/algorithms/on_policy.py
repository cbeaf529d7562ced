"""Hyper-parameters that TRPO and PPO share. Imports no JAX, so that `--help` answers at once."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from planspace.errors import check_layers, check_setting, unknown
from planspace.seams import unset_if

CriticName = Literal["linear", "mlp"]


@dataclass(frozen=True)
class OnPolicy:
    """Hyper-parameters of policy, critic and advantages; the defaults are those of TRPO in 2020."""

    discount: float = 0.99
    """Discount factor gamma."""
    gae_lambda: float = 0.98
    """lambda of generalised advantage estimation."""
    critic: CriticName = "linear"
    """`linear`: ridge regression on simple features. `mlp`: a network with tanh units."""
    hidden: tuple[int, ...] = (32, 32)
    """Units of the policy's hidden layers."""
    critic_hidden: tuple[int, ...] = (32, 32)
    """Units of the hidden layers of an `mlp` critic."""
    match_z: int = 0
    """Widen the policy and an `mlp` critic until they have as many parameters as networks that also observe a
    z of this many numbers: a control for what z adds."""
    layer_norm: bool = False
    """Normalise the policy's hidden layers."""
    normalise_obs: bool = False
    """Standardise observations by the mean and standard deviation that each seed has seen so far."""
    normalise_advantages: bool = True
    """Bring the advantages of each iteration to mean 0 and standard deviation 1."""
    bootstrap_timeout: bool = False
    """Count the value of the state at the time limit; the 2020 runs counted nothing beyond it."""
    entropy_reward: float = 0.0
    """Reward per nat of the policy's entropy, without a gradient."""
    initial_std: float = field(default=1.0, metadata=unset_if(1.0))
    """Standard deviation of the policy's actions before training, in units of the control. A policy that
    clones plans needs less noise than one that explores from nothing."""

    def __post_init__(self) -> None:
        """Check names and sizes.

        Raises:
            UsageError: the critic is unknown, a layer has no units, or a number is out of its range.
        """
        if self.critic not in get_args(CriticName):
            raise unknown("critic", self.critic, get_args(CriticName))
        check_layers("hidden", self.hidden)
        check_layers("critic_hidden", self.critic_hidden)
        for name in ("discount", "gae_lambda"):
            check_setting(name, getattr(self, name), 0 <= getattr(self, name) <= 1, "between 0 and 1")
        for name in ("match_z", "entropy_reward"):
            value = getattr(self, name)
            check_setting(name, value, 0 <= value < math.inf, "at least 0 and finite")
        std = self.initial_std
        check_setting("initial_std", std, 0 < std < math.inf, "above 0 and finite")


TRPO_2020 = OnPolicy()
"""The 2020 runs' settings of TRPO."""
PPO_2020 = OnPolicy(gae_lambda=0.95, critic="mlp", normalise_advantages=False, entropy_reward=0.02)
"""The 2020 runs' settings of PPO."""
MODERN = OnPolicy(gae_lambda=0.95, critic="mlp", normalise_obs=True, bootstrap_timeout=True)
"""Not the linear critic: where values beyond the time limit count, its errors feed back and can run away."""
