"""The small tanh network that policies and critics are made of: in JAX to learn, in NumPy to act."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Key

VARIANCE_FLOOR = 1e-5
"""Added to the variance in layer normalisation."""


class MLP(eqx.Module):
    """Tanh layers and a linear one; Glorot-uniform weights, zero biases.

    With `layer_norm`, what a hidden layer is about to squash is brought to mean 0 and deviation 1 over its
    units, without gain or bias (Ba et al. 2016).
    """

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    layer_norm: bool = eqx.field(static=True)

    def __init__(self, sizes: tuple[int, ...], *, layer_norm: bool = False, key: Key[Array, ""]):
        """Draws fresh weights for layers of these sizes, inputs first."""
        keys = jr.split(key, len(sizes) - 1)
        init = jax.nn.initializers.glorot_uniform(in_axis=1, out_axis=0)
        self.weights = [init(k, (b, a)) for k, a, b in zip(keys, sizes[:-1], sizes[1:], strict=True)]
        self.biases = [jnp.zeros(b) for b in sizes[1:]]
        self.layer_norm = layer_norm

    def __call__(self, x: Float[Array, " in"]) -> Float[Array, " out"]:
        """The output for one input."""
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = weight @ x + bias
            if self.layer_norm:
                x = (x - x.mean()) / jnp.sqrt(x.var() + VARIANCE_FLOOR)
            x = jnp.tanh(x)
        return self.weights[-1] @ x + self.biases[-1]


class Stack:
    """Networks with an axis of seeds in NumPy: called once a step, where a JAX call costs more than it."""

    def __init__(self, networks: MLP):
        """Copies the weights."""
        self._weights = [np.ascontiguousarray(np.asarray(w).transpose(0, 2, 1)) for w in networks.weights]
        self._biases = [np.asarray(b)[:, None, :] for b in networks.biases]
        self._layer_norm = networks.layer_norm

    def __call__(self, x: Float[np.ndarray, "seed row in"]) -> Float[np.ndarray, "seed row out"]:
        """The output of each network for each of its rows."""
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            x = x @ weight + bias
            if self._layer_norm:
                x = x - x.mean(axis=-1, keepdims=True)
                x = x / np.sqrt(np.mean(x**2, axis=-1, keepdims=True) + VARIANCE_FLOOR)
            x = np.tanh(x)
        return x @ self._weights[-1] + self._biases[-1]
