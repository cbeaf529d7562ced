"""What an embedding is trained to maximise, written for one triplet.

Notation (paper): x_a, x_t, x_b a triplet of states, evenly spaced in time; q_a = q(z|x_a) and so on;
z_hat a sample of the midpoint of q_a and q_b, where a straight plan has z_t.
"""

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

from planspace.embed.gaussian import DiagonalGaussian, kl, kl_to_prior
from planspace.embed.networks import PlanSpaceModel


class Terms(eqx.Module):
    """The bound and what it is made of."""

    bound: Float[Array, "..."]
    """Equation 7, to be maximised."""
    log_likelihood: Float[Array, "..."]
    """log p of the three states, given their samples."""
    prior_kl: Float[Array, "..."]
    """KL of q_a and q_b to the prior."""
    midpoint_kl: Float[Array, "..."]
    """KL of the midpoint to q_t, before lambda."""


def midpoint(q_a: DiagonalGaussian, q_b: DiagonalGaussian) -> DiagonalGaussian:
    """The distribution of (z_a + z_b) / 2 (equation 9), its variance doubled.

    The variance of a mean of two is half of each; doubled, it matches q(z|x_t), to which it is compared
    (paper, section on the variational embedding).
    """
    return DiagonalGaussian((q_a.mu + q_b.mu) / 2, jnp.sqrt((q_a.sigma**2 + q_b.sigma**2) / 2))


def variational(
    model: PlanSpaceModel, triplet: Float[Array, "3 input"], linearity: float, *, key: Key[Array, ""]
) -> Terms:
    """The variational bound of one triplet, by one sample (SGVB estimator B).

    Source: equation 7; `linearity` is its lambda.
    """
    x_a, x_t, x_b = triplet
    q_a, q_t, q_b = model.encode(x_a), model.encode(x_t), model.encode(x_b)
    q_mid = midpoint(q_a, q_b)  # plans are straight in z: z_t lies halfway between z_a and z_b
    a_key, mid_key, b_key = jr.split(key, 3)
    z_a, z_hat, z_b = q_a.sample(key=a_key), q_mid.sample(key=mid_key), q_b.sample(key=b_key)
    log_likelihood = (
        model.decode(z_a).log_prob(x_a) + model.decode(z_hat).log_prob(x_t) + model.decode(z_b).log_prob(x_b)
    )
    prior_kl = kl_to_prior(q_a) + kl_to_prior(q_b)
    midpoint_kl = kl(q_mid, q_t)
    return Terms(log_likelihood - prior_kl - linearity * midpoint_kl, log_likelihood, prior_kl, midpoint_kl)
