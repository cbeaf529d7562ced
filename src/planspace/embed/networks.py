"""Encoder q(z|x), decoder p(x|z) and, for embed-to-control, the dynamics of z."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

from planspace.embed.gaussian import DiagonalGaussian
from planspace.embed.mlp import forward

ROUNDED_BELOW = -10.0
"""In float32, exp(x) - 1 + 1 has lost three digits there, and is 0 from -17 on."""


class GaussianNetwork(eqx.Module):
    """A ReLU network whose output is a diagonal Gaussian.

    The mean is linear; the standard deviation is ELU + 1 (equation 12) plus a floor, which is 0 in the paper.
    Weights are Glorot-uniform and biases zero, as in the 2020 code.
    """

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    sigma_floor: float = eqx.field(static=True)

    def __init__(
        self, num_in: int, num_out: int, hidden: Sequence[int], sigma_floor: float, *, key: Key[Array, ""]
    ):
        """Draw fresh weights."""
        self.weights, self.biases = glorot_layers((num_in, *hidden, 2 * num_out), key)
        self.sigma_floor = sigma_floor

    def __call__(self, x: Float[Array, " in"]) -> DiagonalGaussian:
        """Compute the Gaussian for one input."""
        mu, rho = jnp.split(_forward(self.weights, self.biases, x), 2)
        return DiagonalGaussian(mu, positive(rho) + self.sigma_floor)


class Transition(eqx.Module):
    """The next z: A(z) z + B(z) u + o(z) with A = I + v r^T (Watter et al. 2015, section 2.4)."""

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    z_dim: int = eqx.field(static=True)
    num_controls: int = eqx.field(static=True)

    def __init__(self, z_dim: int, num_controls: int, hidden: Sequence[int], *, key: Key[Array, ""]):
        """Draw fresh weights."""
        self.weights, self.biases = glorot_layers((z_dim, *hidden, (3 + num_controls) * z_dim), key)
        self.z_dim, self.num_controls = z_dim, num_controls

    def __call__(
        self, z: Float[Array, " z"], q: DiagonalGaussian, control: Float[Array, " control"]
    ) -> DiagonalGaussian:
        """Compute the distribution of the next z, with the dynamics at a sample z of q."""
        v, r, offset, *b = jnp.split(_forward(self.weights, self.biases, z), 3 + self.num_controls)
        a = jnp.eye(self.z_dim) + jnp.outer(v, r)
        mu = a @ q.mu + jnp.stack(b, axis=1) @ control + offset
        return DiagonalGaussian(mu, jnp.sqrt(a**2 @ q.sigma**2))


class PlanSpaceModel(eqx.Module):
    """Everything that is trained. Its inputs are those that `Inputs` computes from a state."""

    encode: GaussianNetwork
    """q(z|x)."""
    decode: GaussianNetwork
    """p(x|z)."""
    log_scale: Float[Array, ""]
    """Log of the length in z of one mean duration, for the distance term."""
    transition: Transition | None
    """The dynamics of z, for embed-to-control."""

    def __init__(
        self,
        num_inputs: int,
        z_dim: int,
        hidden: Sequence[int],
        sigma_floor: float,
        *,
        num_controls: int = 0,
        key: Key[Array, ""],
    ):
        """Draw fresh weights; the floor applies to the decoder's standard deviation only."""
        encode_key, decode_key, transition_key = jr.split(key, 3)
        self.encode = GaussianNetwork(num_inputs, z_dim, hidden, 0.0, key=encode_key)
        self.decode = GaussianNetwork(z_dim, num_inputs, hidden, sigma_floor, key=decode_key)
        self.log_scale = jnp.zeros(())
        self.transition = (
            Transition(z_dim, num_controls, hidden, key=transition_key) if num_controls else None
        )

    @property
    def scale(self) -> Float[Array, ""]:
        """The length in z of one mean duration of a demonstration."""
        return jnp.exp(self.log_scale)


_glorot_uniform: Callable[..., Array] = jax.nn.initializers.glorot_uniform(in_axis=1, out_axis=0)


def glorot_layers(sizes: Sequence[int], key: Key[Array, ""]) -> tuple[list[Array], list[Array]]:
    """Draw Glorot-uniform weights [out, in] and zero biases of layers with the given sizes."""
    keys = jr.split(key, len(sizes) - 1)
    weights = [_glorot_uniform(k, (b, a)) for k, a, b in zip(keys, sizes[:-1], sizes[1:], strict=True)]
    return weights, [jnp.zeros(b) for b in sizes[1:]]


def positive(rho: Array) -> Array:
    """ELU + 1 (equation 12). Below 0 it equals exp, which is used where the sum would round to 0."""
    return jnp.where(rho < ROUNDED_BELOW, jnp.exp(jnp.minimum(rho, 0.0)), jax.nn.elu(rho) + 1.0)


def _forward(weights: list[Array], biases: list[Array], x: Array) -> Array:
    layers = [(weight.T, bias) for weight, bias in zip(weights, biases, strict=True)]
    return forward(layers, x, jax.nn.relu)
