"""The forward pass of a multilayer perceptron, for NumPy and JAX alike."""

from collections.abc import Callable, Iterable
from typing import Any

Layer = tuple[Any, Any]
"""Weights [in, out] and biases [out]; a leading axis of seeds is possible in both."""


def forward(layers: Iterable[Layer], x: Any, activation: Callable[[Any], Any]) -> Any:
    """Compute the output of a multilayer perceptron.

    Args:
        layers: weights and biases, the first layer first; arrays of NumPy or of JAX.
        x: the input [*batch, in].
        activation: applied after each layer but the last. It may overwrite its argument.

    Returns:
        The output [*batch, out].
    """
    *hidden, (last_weight, last_bias) = layers
    for weight, bias in hidden:
        x = activation(x @ weight + bias)
    return x @ last_weight + last_bias
