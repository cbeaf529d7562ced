"""Gaussian policies: a tanh network for the mean, and one standard deviation for all states."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from planspace.embed.gaussian import DiagonalGaussian
from planspace.rl.mlp import MLP
from planspace.rl.normalise import ObsStatistics
from planspace.rl.policy_network import PolicyNetwork

UNIT_ENTROPY = 0.5 * math.log(2 * math.pi * math.e)
"""Entropy of N(0, 1) [nat]; that of N(mu, sigma^2) is larger by log sigma."""


class GaussianPolicy(eqx.Module):
    """pi(a|o) = N(mean(o), exp(log_std)^2)."""

    mean: MLP
    log_std: Float[Array, " action"]

    def __init__(
        self,
        num_obs: int,
        num_actions: int,
        *,
        hidden: tuple[int, ...] = (32, 32),
        layer_norm: bool = False,
        std: float = 1.0,
        key: Key[Array, ""],
    ):
        """Draw the weights; `std` is the first standard deviation of every action."""
        self.mean = MLP((num_obs, *hidden, num_actions), layer_norm=layer_norm, key=key)
        self.log_std = jnp.full(num_actions, math.log(std), jnp.float32)

    def __call__(self, obs: Float[Array, " obs"]) -> DiagonalGaussian:
        """Distribution of actions for one observation."""
        return DiagonalGaussian(self.mean(obs), jnp.exp(self.log_std))

    def log_prob(
        self, obs: Float[Array, "*batch obs"], actions: Float[Array, "*batch action"]
    ) -> Float[Array, "*batch"]:
        """Log-density of actions [nat]."""
        rows = obs.reshape(-1, obs.shape[-1]), actions.reshape(-1, actions.shape[-1])
        return jax.vmap(lambda o, a: self(o).log_prob(a))(*rows).reshape(actions.shape[:-1])

    def network(self, statistics: ObsStatistics | None = None) -> PolicyNetwork:
        """The network of the mean action, as plain arrays.

        Args:
            statistics: what the whole observation is standardised by, if anything.
        """
        weights, biases = (list(map(np.asarray, part)) for part in (self.mean.weights, self.mean.biases))
        return PolicyNetwork(weights, biases, np.asarray(self.log_std), self.mean.layer_norm, statistics)

    def entropy(self) -> Float[Array, ""]:
        """Entropy of the action distribution, the same everywhere [nat]."""
        return jnp.sum(self.log_std + UNIT_ENTROPY)


def mean_action(policy: GaussianPolicy, obs: Float[Array, " obs"]) -> Float[Array, " action"]:
    """The mean action for one observation."""
    return policy.mean(obs)


class UpdateInfo(eqx.Module):
    """Result of an update of a policy."""

    kl: Float[Array, ""]
    """Mean KL from the old policy to the new [nat]."""
    loss: Float[Array, ""]
    """Negative surrogate objective after the update."""
    improvement: Float[Array, ""]
    """Increase of the surrogate objective."""
    entropy: Float[Array, ""]
    """Entropy of the new policy [nat]."""
    rounds: Int[Array, ""]
    """Steps that the line search of TRPO tried, or epochs of PPO."""
    skipped: Bool[Array, ""]
    """Whether the policy is unchanged, because no step was accepted, the curvature was not positive, or a
    number was not finite."""
