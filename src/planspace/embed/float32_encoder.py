"""An encoder as float32 arrays, for programs that compute z outside NumPy: ONNX, PyTorch and JAX.

For states x [batch, state]:

    features    x as it is; for `trig`, the other columns, then sin and cos of the circular ones, then each
                number of `rotation_columns` for all quaternions
    centred     features - mean
    h           ReLU layers; 1 / std is folded into the first weights
    mu, rho     linear layers; the embedding's linear map is folded into mu
    sigma       ELU(rho) + 1 (equation 12), before the linear map

The mean is not folded into the first bias: that would lose digits where a state is large compared with its
standard deviation. Only what float32 cuts off the mean is folded in. Subtracting it as a second number is not
safe, because XLA adds the two constants first. Angles are not wrapped: sin and cos are exact to 1e-7 at any
angle.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64

from planspace.embed.embedding import Embedding, LinearMap
from planspace.embed.inputs import Inputs
from planspace.physics.quaternion import ROTATION_SIZE

Layer = tuple[Float32[np.ndarray, "_ _"], Float32[np.ndarray, " _"]]
"""Weights [out, in] and biases [out]."""


@dataclass(frozen=True)
class Float32Encoder:
    """The arrays of q(z|x) in float32."""

    straight: Int64[np.ndarray, " straight"]
    """Columns of the state that are features as they are."""
    circular: Int64[np.ndarray, " circular"]
    """Columns whose sin and cos are features."""
    quaternions: Int64[np.ndarray, "4 quaternion"]
    """Columns of w, x, y and z whose rotation matrices are features."""
    mean: Float32[np.ndarray, " input"]
    """Subtracted from the features."""
    hidden: tuple[Layer, ...]
    """The layers before a ReLU."""
    mu: Layer
    """The layer that gives z."""
    rho: Layer
    """The layer that gives the standard deviation."""


def float32_encoder(embedding: Embedding) -> Float32Encoder:
    """Compute the arrays from an embedding, in float64, and round them."""
    inputs, z = embedding.inputs, embedding.z_dim
    trig = inputs.form == "trig"
    circular = np.array(sorted(inputs.circular_columns if trig else ()), np.int64)
    quaternions = np.array(inputs.quaternions if trig else (), np.int64).reshape(-1, 4).T
    straight = np.setdiff1d(np.arange(embedding.state_dim), [*circular, *quaternions.ravel()]).astype(
        np.int64
    )
    sines, rotations = _places(inputs, circular), _places(inputs, quaternions[0])
    order = np.concatenate(
        [_places(inputs, straight), sines, sines + 1, *(rotations + k for k in range(ROTATION_SIZE))]
    )
    weights, biases = ([array.astype(np.float64) for array in arrays] for arrays in embedding.encoder)
    mean = inputs.mean[order].astype(np.float32)
    weights[0] = weights[0][:, order] / inputs.std[order]
    biases[0] = biases[0] - weights[0] @ (inputs.mean[order] - mean)
    linear_map = embedding.linear_map or LinearMap(np.eye(z), np.zeros(z))
    matrix = linear_map.matrix.astype(np.float64)
    return Float32Encoder(
        straight,
        circular,
        quaternions,
        mean,
        tuple(map(_rounded, weights[:-1], biases[:-1])),
        _rounded(matrix.T @ weights[-1][:z], (biases[-1][:z] - linear_map.centre) @ matrix),
        _rounded(weights[-1][z:], biases[-1][z:]),
    )


def _places(inputs: Inputs, columns: np.ndarray) -> np.ndarray:
    """The first input of each column."""
    return np.array([inputs.columns.index(column) for column in columns], np.int64)


def _rounded(weight: np.ndarray, bias: np.ndarray) -> Layer:
    return np.ascontiguousarray(weight, np.float32), bias.astype(np.float32)
