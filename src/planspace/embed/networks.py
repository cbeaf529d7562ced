"""Encoder q(z|x) and decoder p(x|z): one small network each, with a mean and a deviation as outputs."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

from planspace.embed.gaussian import DiagonalGaussian

HIDDEN = (64, 64)
"""Paper, section on the variational embedding: two hidden layers of 64 units."""


class GaussianNetwork(eqx.Module):
    """A ReLU network whose output is a diagonal Gaussian.

    The mean is linear; the deviation is ELU + 1 (equation 12) plus a floor, which is 0 in the paper.
    Weights are Glorot-uniform and biases zero, as in the 2020 code.
    """

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    sigma_floor: float = eqx.field(static=True)

    def __init__(self, num_in: int, num_out: int, sigma_floor: float, *, key: Key[Array, ""]):
        """Draws fresh weights."""
        sizes = (num_in, *HIDDEN, 2 * num_out)
        keys = jr.split(key, len(sizes) - 1)
        self.weights = [
            _glorot_uniform(k, (b, a)) for k, a, b in zip(keys, sizes[:-1], sizes[1:], strict=True)
        ]
        self.biases = [jnp.zeros(b) for b in sizes[1:]]
        self.sigma_floor = sigma_floor

    def __call__(self, x: Float[Array, " in"]) -> DiagonalGaussian:
        """The Gaussian for one input."""
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = jax.nn.relu(weight @ x + bias)
        mu, rho = jnp.split(self.weights[-1] @ x + self.biases[-1], 2)
        return DiagonalGaussian(mu, jax.nn.elu(rho) + 1.0 + self.sigma_floor)


class PlanSpaceModel(eqx.Module):
    """Encoder and decoder, over the inputs the embedding's features make of a state."""

    encode: GaussianNetwork
    """q(z|x)."""
    decode: GaussianNetwork
    """p(x|z)."""

    def __init__(self, num_inputs: int, z_dim: int, sigma_floor: float, *, key: Key[Array, ""]):
        """Draws fresh weights; the floor holds for the decoder's deviation alone."""
        encode_key, decode_key = jr.split(key)
        self.encode = GaussianNetwork(num_inputs, z_dim, 0.0, key=encode_key)
        self.decode = GaussianNetwork(z_dim, num_inputs, sigma_floor, key=decode_key)


_glorot_uniform: Callable[..., Array] = jax.nn.initializers.glorot_uniform(in_axis=1, out_axis=0)
