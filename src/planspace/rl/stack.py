"""Small networks in NumPy, one per seed. Calling JAX to act would take longer than the network."""

from collections.abc import Sequence
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from planspace.embed.mlp import forward

Activation = Literal["tanh", "relu"]
"""What hidden units compute."""
VARIANCE_FLOOR = 1e-5
"""Added to the variance in layer normalisation, so that it is never divided by 0."""


@runtime_checkable
class Layers(Protocol):
    """Any network of such layers: `rl.mlp.MLP` or `PolicyNetwork`."""

    @property
    def weights(self) -> Sequence[Any]:
        """Weights [out, in] of each layer."""
        ...

    @property
    def biases(self) -> Sequence[Any]:
        """Biases [out] of each layer."""
        ...

    @property
    def layer_norm(self) -> bool:
        """Whether hidden layers are normalised before the activation."""
        ...

    @property
    def activation(self) -> Activation:
        """The activation of hidden layers."""
        ...


class Stack:
    """`rl.mlp.MLP` with a leading axis of seeds."""

    def __init__(
        self,
        weights: Sequence[np.ndarray],
        biases: Sequence[np.ndarray],
        *,
        layer_norm: bool,
        activation: Activation = "tanh",
    ):
        """Copy weights [seed, out, in] and biases [seed, out] of each layer."""
        self._layers = [
            (np.ascontiguousarray(np.asarray(weight).transpose(0, 2, 1)), np.asarray(bias)[:, None, :])
            for weight, bias in zip(weights, biases, strict=True)
        ]
        self._layer_norm, self._activation = layer_norm, activation

    def __call__(self, x: Float[np.ndarray, "seed row in"]) -> Float[np.ndarray, "seed row out"]:
        """Output of each network for each of its rows."""
        return forward(self._layers, x, self._activate)

    def _activate(self, x: np.ndarray) -> np.ndarray:
        if self._layer_norm:
            x = x - x.mean(axis=-1, keepdims=True)
            x = x / np.sqrt(np.mean(x**2, axis=-1, keepdims=True) + VARIANCE_FLOOR)
        return np.maximum(x, 0.0) if self._activation == "relu" else np.tanh(x)


def scaled(
    x: Float[np.ndarray, "*batch action"],
    low: Float[np.ndarray, "*limit action"],
    high: Float[np.ndarray, "*limit action"],
) -> Float[np.ndarray, "*batch action"]:
    """Actions between their limits for numbers between -1 and 1."""
    return (low + high) / 2 + (high - low) / 2 * x


def stacked(networks: Sequence[Layers]) -> Stack:
    """Networks of the same sizes as one, with a leading axis."""
    first = networks[0]
    return Stack(*stacked_layers(networks), layer_norm=first.layer_norm, activation=first.activation)


def stacked_layers(networks: Sequence[Layers]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights [seed, out, in] and biases [seed, out] of each layer."""
    layers = range(len(networks[0].weights))
    weights = [np.stack([np.asarray(n.weights[k]) for n in networks]) for k in layers]
    return weights, [np.stack([np.asarray(n.biases[k]) for n in networks]) for k in layers]
