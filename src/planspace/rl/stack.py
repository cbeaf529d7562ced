"""Small tanh networks in NumPy, one a seed: for acting, where a call of JAX costs more than the network."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

VARIANCE_FLOOR = 1e-5
"""Added to the variance in layer normalisation."""


class Stack:
    """`rl.mlp.MLP` with a leading axis of seeds."""

    def __init__(self, weights: Sequence[np.ndarray], biases: Sequence[np.ndarray], *, layer_norm: bool):
        """Copies weights [seed, out, in] and biases [seed, out] of each layer."""
        self._weights = [np.ascontiguousarray(np.asarray(w).transpose(0, 2, 1)) for w in weights]
        self._biases = [np.asarray(b)[:, None, :] for b in biases]
        self._layer_norm = layer_norm

    def __call__(self, x: Float[np.ndarray, "seed row in"]) -> Float[np.ndarray, "seed row out"]:
        """The output of each network for each of its rows."""
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            x = x @ weight + bias
            if self._layer_norm:
                x = x - x.mean(axis=-1, keepdims=True)
                x = x / np.sqrt(np.mean(x**2, axis=-1, keepdims=True) + VARIANCE_FLOOR)
            x = np.tanh(x)
        return x @ self._weights[-1] + self._biases[-1]
