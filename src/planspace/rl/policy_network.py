"""How a policy acts, as plain arrays: what an algorithm exports and what is saved. Needs NumPy only."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from planspace.rl.normalise import ObsStatistics
from planspace.rl.stack import Activation, scaled, stacked


@dataclass(frozen=True, eq=False)
class PolicyNetwork:
    """The deterministic action of one seed's policy."""

    weights: Sequence[Float[np.ndarray, "_out _in"]]
    """Weights of each layer, from the observation to the action."""
    biases: Sequence[Float[np.ndarray, " _out"]]
    """Biases of each layer."""
    log_std: Float[np.ndarray, " action"] | None = None
    """Logarithm of the standard deviation of the exploration noise in training; None without noise."""
    layer_norm: bool = False
    """Whether hidden layers are normalised before the activation."""
    statistics: ObsStatistics | None = None
    """Mean and standard deviation by which the whole observation is standardised."""
    activation: Activation = "tanh"
    """The activation of hidden layers; the output is linear."""
    limits: tuple[Float[np.ndarray, " action"], Float[np.ndarray, " action"]] | None = None
    """Lower and upper limits between which tanh squashes the output; None if the output is the action."""


class Actor:
    """The policies of all seeds as they act in training; one call acts in every environment."""

    def __init__(self, networks: Sequence[PolicyNetwork], columns: slice = slice(None)):
        """Copy the weights.

        Args:
            networks: one per seed, all with the same sizes.
            columns: the part of an observation that the networks read.
        """
        self._mean, self._columns = stacked(networks), columns
        parts = [n.statistics for n in networks if n.statistics is not None]
        self._statistics = ObsStatistics.stacked(parts) if parts else None
        self._std = np.exp(np.stack(logs)) if (logs := log_stds(networks)) else None
        self._limits = stacked_limits(networks)

    def __call__(
        self, obs: Float[np.ndarray, "seed env obs"], noise: Float[np.ndarray, "seed env action"]
    ) -> Float[np.ndarray, "seed env action"]:
        """The action of each policy in each of its environments, with its exploration noise."""
        if self._statistics is not None:
            obs = self._statistics(obs)
        mean = self._mean(obs[..., self._columns])
        if self._limits is not None:
            mean = scaled(np.tanh(mean), *(limit[:, None] for limit in self._limits))
        return mean if self._std is None else mean + noise * self._std[:, None, :]


def log_stds(networks: Sequence[PolicyNetwork]) -> list[np.ndarray]:
    """Logarithm of the standard deviation of each network's exploration; empty if they do not explore."""
    return [np.asarray(n.log_std) for n in networks if n.log_std is not None]


def stacked_limits(
    networks: Sequence[PolicyNetwork],
) -> tuple[Float[np.ndarray, "seed action"], Float[np.ndarray, "seed action"]] | None:
    """The limits between which the output of each network is squashed; None if they are not."""
    found = [n.limits for n in networks if n.limits is not None]
    if not found:
        return None
    low, high = (np.stack(part).astype(np.float32) for part in zip(*found, strict=True))
    return low, high
