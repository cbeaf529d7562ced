"""The network in NumPy: convolutions of 4 x 4 pixels with stride 2, one hidden layer, a linear output.

A picture is divided into blocks of 2 x 2 pixels, so that a convolution is one matrix product over 2 x 2
neighbouring blocks.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from planspace.embed.embedding import LinearMap
from planspace.embed.mlp import Layer, forward

KERNEL = 4
"""Width and height of a convolution's kernel [pixels]; its stride is half of it, its padding 1."""


@dataclass(frozen=True)
class ConvolutionalNetwork:
    """Weights of a trained network, as they are saved."""

    kernels: tuple[Layer, ...]
    """Weights [4, 4, in, out] and biases [out] of each convolution."""
    dense: tuple[Layer, ...]
    """Weights [in, out] and biases [out] of the hidden layer and of the output."""

    def __call__(self, stack: UInt8[np.ndarray, "height width channel"]) -> Float[np.ndarray, " out"]:
        """Compute the output for one stack; one at a time is fastest, because it stays in the cache."""
        x = to_input(stack)
        for kernel, bias in self.kernels:
            x = np.maximum(_blocks(x) @ as_matrix(kernel) + bias, 0.0)
        return forward(self.dense, x.reshape(1, -1), lambda h: np.maximum(h, 0.0))[0]


def with_linear_map(network: ConvolutionalNetwork, to_z: LinearMap) -> ConvolutionalNetwork:
    """Keep the first outputs of a network, the mean of z before a linear map, and apply the map to them."""
    *hidden, (weight, bias) = network.dense
    kept = len(to_z.centre)
    last = weight[:, :kept] @ to_z.matrix, (bias[:kept] - to_z.centre) @ to_z.matrix
    return replace(network, dense=(*hidden, last))


def to_input(stack: Any) -> Any:
    """Scale the bytes of pictures, an array of NumPy or of JAX, to float32 in [-0.5, 0.5]."""
    return stack.astype(np.float32) * np.float32(1 / 255) - np.float32(0.5)


def as_matrix(kernel: Float[np.ndarray, "4 4 in out"]) -> Float[np.ndarray, "rows out"]:
    """Reorder a kernel to the order of `_blocks`."""
    parts = kernel.reshape(2, 2, 2, 2, *kernel.shape[2:])  # block row, row in it, block column, column in it
    return parts.transpose(0, 2, 1, 3, 4, 5).reshape(-1, kernel.shape[-1])


def _blocks(x: Float[np.ndarray, "height width channel"]) -> Float[np.ndarray, "height2 width2 rows"]:
    """Every 4 x 4 patch at stride 2, as one row."""
    height, width, channels = x.shape
    padded = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    parts = padded.reshape(height // 2 + 1, 2, width // 2 + 1, 2, channels).transpose(0, 2, 1, 3, 4)
    blocks = parts.reshape(height // 2 + 1, width // 2 + 1, 4 * channels)
    corners = (blocks[:-1, :-1], blocks[:-1, 1:], blocks[1:, :-1], blocks[1:, 1:])
    return np.concatenate(corners, axis=-1)
