"""Terms that losses of objectives are made of, for one sample.

Notation (paper): x_a, x_t, x_b are states of one demonstration, in this order; q_a = q(z|x_a) and so on; w is
the fraction of the time from a to b that has passed at t (1/2 in the paper); z_hat is a sample of the point
at that fraction between q_a and q_b, where z_t lies if plans are straight and have constant speed.
"""

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

from planspace.embed.gaussian import DiagonalGaussian, kl, kl_to_prior
from planspace.embed.networks import PlanSpaceModel

SMALL = 1e-6
"""Keeps lengths away from 0, where they have no gradient."""

Terms = dict[str, Float[Array, "..."]]
"""Parts of a loss by name, for the training log."""


def between(
    q_a: DiagonalGaussian, q_b: DiagonalGaussian, w: Float[Array, ""], *, double_variance: bool
) -> DiagonalGaussian:
    """The distribution of (1 - w) z_a + w z_b; for w = 1/2 the midpoint of equation 9.

    The variance of the mean of two is half of each. Doubled, it matches q(z|x_t), with which it is compared
    (paper, section on the implementation). For any w, the variance is then interpolated like the mean.
    """
    mu = (1 - w) * q_a.mu + w * q_b.mu
    if double_variance:
        return DiagonalGaussian(mu, jnp.sqrt((1 - w) * q_a.sigma**2 + w * q_b.sigma**2))
    return DiagonalGaussian(mu, jnp.sqrt((1 - w) ** 2 * q_a.sigma**2 + w**2 * q_b.sigma**2))


def balanced_kl(p: DiagonalGaussian, q: DiagonalGaussian, balance: float) -> Float[Array, ""]:
    """KL(p || q) with twice `balance` of the gradient for q and the rest for p (Hafner et al. 2023)."""
    if balance == 0.5:
        return kl(p, q)
    stop = jax.lax.stop_gradient
    value = 2 * balance * kl(stop(p), q) + 2 * (1 - balance) * kl(p, stop(q))
    return value + stop(kl(p, q) - value)


def curvature(z_a: Float[Array, " z"], z_t: Float[Array, " z"], z_b: Float[Array, " z"]) -> Float[Array, ""]:
    """1 - cos of the angle between z_t - z_a and z_b - z_t."""
    first, second = z_t - z_a, z_b - z_t
    return 1 - jnp.dot(first, second) / (length(first) * length(second))


def length(x: Float[Array, " dim"]) -> Float[Array, ""]:
    """Euclidean length, with a gradient at 0."""
    return jnp.sqrt(jnp.sum(x**2) + SMALL)


def autoencode(
    model: PlanSpaceModel, x: Float[Array, " input"], *, key: Key[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Log p(x|z) of a state for a sample z of q(z|x), and the KL of q(z|x) to the prior."""
    q = model.encode(x)
    return model.decode(q.sample(key=key)).log_prob(x), kl_to_prior(q)


def autoencoder_loss(
    model: PlanSpaceModel, x: Float[Array, "3 input"], prior: float, *, key: Key[Array, ""]
) -> tuple[Float[Array, ""], Terms]:
    """Minus the bound of a variational auto-encoder on three states, and its terms."""
    log_p, divergence = jax.vmap(lambda x, k: autoencode(model, x, key=k))(x, jr.split(key, 3))
    log_likelihood, prior_kl = log_p.sum(), divergence.sum()
    terms = {"log_likelihood": log_likelihood, "prior_kl": prior_kl}
    return -(log_likelihood - prior * prior_kl), terms


def read_out(model: PlanSpaceModel, x: Float[Array, "3 input"]) -> Float[Array, ""]:
    """Log p of three states given the means of their z, with a gradient to the decoder only."""

    def one(x: Array) -> Array:
        return model.decode(jax.lax.stop_gradient(model.encode(x).mu)).log_prob(x)

    return jax.vmap(one)(x).sum()
