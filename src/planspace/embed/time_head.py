"""The time to go between two states, in seconds. NumPy only.

Notation: h(x) is a network from what it reads of a state to `features` numbers.

    d(a, b) = max over i of (h_i(b) - h_i(a))_+

is a quasimetric: it is never negative, d(a, a) = 0, and d(a, c) <= d(a, b) + d(b, c), but d(a, b) and d(b, a)
may differ, as shortest times do. Every quasimetric on n states has this form with n features, for example
h_i(x) = d(x_i, x). So the form itself excludes no shortest times.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from planspace.embed.mlp import forward

ARCHITECTURE = "max-difference"
"""The only architecture; a file names it."""
TimeInput = Literal["state", "z", "both"]
TIME_INPUTS: tuple[TimeInput, ...] = get_args(TimeInput)
"""What the network reads: the encoder's inputs, z, or both."""


@dataclass(frozen=True)
class TimeHead:
    """A network h that estimates shortest times."""

    weights: list[np.ndarray]
    """Weights [out, in] of each layer."""
    biases: list[np.ndarray]
    """Biases [out] of each layer."""
    reads: TimeInput = "state"
    """What the network reads of a state."""

    def features(self, read: Float[np.ndarray, "*batch read"]) -> Float[np.ndarray, "*batch feature"]:
        """H of some states.

        Args:
            read: what the network reads of them; see `Embedding.time_inputs`.
        """
        layers = [(weight.T, bias) for weight, bias in zip(self.weights, self.biases, strict=True)]
        return forward(layers, read.astype(self.weights[0].dtype), lambda hidden: np.maximum(hidden, 0.0))


def quasimetric(
    a: Float[np.ndarray, "*batch feature"], b: Float[np.ndarray, "*batch2 feature"]
) -> Float[np.ndarray, "*batch3"]:
    """d(a, b) from the features of both states."""
    return np.asarray(np.maximum(b - a, 0.0).max(axis=-1))
