"""Gaussian policies: a small tanh network for the mean, a deviation that does not depend on the state."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Key

from planspace.embed.gaussian import DiagonalGaussian

HIDDEN = (32, 32)
"""Paper, RL performance: two fully connected layers of 32 units."""


class GaussianPolicy(eqx.Module):
    """pi(a|o) = N(mean(o), exp(log_std)^2); Glorot-uniform weights, zero biases, log_std 0 at first."""

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    log_std: Float[Array, " action"]

    def __init__(self, num_obs: int, num_actions: int, *, key: Key[Array, ""]):
        """Draws fresh weights."""
        sizes = (num_obs, *HIDDEN, num_actions)
        keys = jr.split(key, len(sizes) - 1)
        init = jax.nn.initializers.glorot_uniform(in_axis=1, out_axis=0)
        self.weights = [init(k, (b, a)) for k, a, b in zip(keys, sizes[:-1], sizes[1:], strict=True)]
        self.biases = [jnp.zeros(b) for b in sizes[1:]]
        self.log_std = jnp.zeros(num_actions)

    def __call__(self, obs: Float[Array, " obs"]) -> DiagonalGaussian:
        """The distribution of actions for one observation."""
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            obs = jnp.tanh(weight @ obs + bias)
        return DiagonalGaussian(self.weights[-1] @ obs + self.biases[-1], jnp.exp(self.log_std))

    def entropy(self) -> Float[Array, ""]:
        """Entropy of the action distribution, the same everywhere [nat]."""
        return jnp.sum(self.log_std + 0.5 * jnp.log(2 * jnp.pi * jnp.e))


class Actor:
    """The means of a stack of policies in NumPy: called once a step, where a JAX call costs more than it."""

    def __init__(self, policies: GaussianPolicy):
        """Copies the weights of policies with a leading axis of seeds."""
        self._weights = [np.asarray(w).transpose(0, 2, 1) for w in policies.weights]
        self._biases = [np.asarray(b)[:, None, :] for b in policies.biases]
        self.std = np.exp(np.asarray(policies.log_std))[:, None, :]

    def mean(self, obs: Float[np.ndarray, "seed env obs"]) -> Float[np.ndarray, "seed env action"]:
        """The mean action of each policy in each of its environments."""
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            obs = np.tanh(obs @ weight + bias)
        return obs @ self._weights[-1] + self._biases[-1]
