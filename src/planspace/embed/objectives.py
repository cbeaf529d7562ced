"""What an embedding is trained to maximise, written for one triplet. One function an objective.

Notation (paper): x_a, x_t, x_b are states of one demonstration, in this order; q_a = q(z|x_a) and so on; w is
the share of the time from a to b that has passed at t (1/2 in the paper); z_hat is a sample of the point that
far between q_a and q_b, where a straight plan at constant speed has z_t; lambda weighs the term for it.

An objective that learns no decoder of its own still trains one, on a z through which no gradient flows, so
that what z knows of the state can be measured for all of them alike.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

from planspace.embed.config import ObjectiveConfig, ObjectiveName
from planspace.embed.gaussian import DiagonalGaussian, kl, kl_to_prior
from planspace.embed.networks import PlanSpaceModel

SMALL = 1e-6
"""Keeps norms away from 0, where they have no gradient."""


class Sample(eqx.Module):
    """Three states of a demonstration and what is known about them."""

    x: Float[Array, "*batch 3 input"]
    """The inputs made of x_a, x_t and x_b."""
    w: Float[Array, "*batch"]
    """The share of the time from a to b that has passed at t."""
    duration: Float[Array, "*batch"]
    """The time from a to b, in mean durations of a demonstration."""
    anywhere: Float[Array, "*batch input"]
    """The inputs of a state put together from numbers of different demonstrations, in a wider range."""
    control: Float[Array, "*batch control"]
    """The control at a, over its deviation; of no width where the demonstrations have none."""


Terms = dict[str, Float[Array, "..."]]
"""`bound`, to be maximised, and what it is made of."""

Objective = Callable[[PlanSpaceModel, Sample, ObjectiveConfig, Key[Array, ""]], Terms]


def variational(model: PlanSpaceModel, sample: Sample, config: ObjectiveConfig, key: Key[Array, ""]) -> Terms:
    """The variational bound of one triplet, by one sample (SGVB estimator B).

    Source: equation 7; the terms weighed by `curvature`, `distance` and `anywhere` are ours.
    """
    x_a, x_t, x_b = sample.x
    q_a, q_t, q_b = model.encode(x_a), model.encode(x_t), model.encode(x_b)
    q_mid = between(q_a, q_b, sample.w, double_variance=config.double_variance)
    a_key, mid_key, b_key, anywhere_key = jr.split(key, 4)
    z_a, z_hat, z_b = q_a.sample(key=a_key), q_mid.sample(key=mid_key), q_b.sample(key=b_key)
    log_likelihood = (
        model.decode(z_a).log_prob(x_a) + model.decode(z_hat).log_prob(x_t) + model.decode(z_b).log_prob(x_b)
    )
    prior_kl = kl_to_prior(q_a) + kl_to_prior(q_b)
    midpoint_kl = _balanced_kl(q_mid, q_t, config.balance)
    bound = log_likelihood - config.prior * prior_kl - config.linearity * midpoint_kl
    terms = {"log_likelihood": log_likelihood, "prior_kl": prior_kl, "midpoint_kl": midpoint_kl}
    if config.curvature:
        terms["curvature"] = _curvature(q_a.mu, q_t.mu, q_b.mu)
        bound -= config.curvature * terms["curvature"]
    if config.distance:
        terms["distance_error"] = (_norm(q_b.mu - q_a.mu) / model.scale - sample.duration) ** 2
        bound -= config.distance * terms["distance_error"]
    if config.anywhere:
        log_p, divergence = _autoencode(model, sample.anywhere, anywhere_key)
        terms["anywhere"] = log_p - config.prior * divergence
        bound += config.anywhere * terms["anywhere"]
    return {"bound": bound, **terms}


def direct(model: PlanSpaceModel, sample: Sample, config: ObjectiveConfig, key: Key[Array, ""]) -> Terms:
    """Minus the distance between x_t and the state decoded from the point between z_a and z_b.

    Source: equations 1 and 2. Encoder and decoder are the means; nothing is sampled.
    """
    x_a, x_t, x_b = sample.x
    q_mid = between(model.encode(x_a), model.encode(x_b), sample.w, double_variance=True)
    error = model.decode(q_mid.mu).mu - x_t
    d = {"l2": _norm, "squared": lambda e: jnp.sum(e**2), "l1": lambda e: jnp.sum(jnp.abs(e))}
    return {"bound": -d[config.metric](error)}


def vae(model: PlanSpaceModel, sample: Sample, config: ObjectiveConfig, key: Key[Array, ""]) -> Terms:
    """The bound of a variational auto-encoder on the same states, which knows nothing of plans.

    Source: Kingma and Welling 2013, equation 10.
    """
    log_p, divergence = jax.vmap(lambda x, k: _autoencode(model, x, k))(sample.x, jr.split(key, 3))
    log_likelihood, prior_kl = log_p.sum(), divergence.sum()
    return {
        "bound": log_likelihood - config.prior * prior_kl,
        "log_likelihood": log_likelihood,
        "prior_kl": prior_kl,
    }


def straightening(
    model: PlanSpaceModel, sample: Sample, config: ObjectiveConfig, key: Key[Array, ""]
) -> Terms:
    """A variational auto-encoder whose latent paths are asked to keep their direction.

    Source: temporal straightening (Wang et al. 2026): 1 - cos of successive differences. Their prediction
    loss, which keeps z from collapsing, is here the reconstruction: it needs no controls.
    """
    terms = vae(model, sample, config, key)
    curvature = _curvature(*(model.encode(x).mu for x in sample.x))
    return {**terms, "bound": terms["bound"] - config.linearity * curvature, "curvature": curvature}


def e2c(model: PlanSpaceModel, sample: Sample, config: ObjectiveConfig, key: Key[Array, ""]) -> Terms:
    """Embed to control: x_t follows x_a by one step, and z follows by dynamics linear at each z.

    Source: Watter et al. 2015, equations 8 to 12; A = I + v r^T, its variance kept diagonal.
    """
    assert model.transition is not None
    x_a, x_t, _ = sample.x
    q_a, q_t = model.encode(x_a), model.encode(x_t)
    a_key, next_key = jr.split(key)
    z_a = q_a.sample(key=a_key)
    q_next = model.transition(z_a, q_a, sample.control)
    log_likelihood = model.decode(z_a).log_prob(x_a) + model.decode(q_next.sample(key=next_key)).log_prob(x_t)
    prior_kl, dynamics_kl = kl_to_prior(q_a), kl(q_next, q_t)
    bound = log_likelihood - config.prior * prior_kl - config.linearity * dynamics_kl
    return {
        "bound": bound,
        "log_likelihood": log_likelihood,
        "prior_kl": prior_kl,
        "dynamics_kl": dynamics_kl,
    }


def distance(model: PlanSpaceModel, sample: Sample, config: ObjectiveConfig, key: Key[Array, ""]) -> Terms:
    """Regression of |z_a - z_b| on the time between, which is what the metrics of time ask for.

    Source: dynamical distance learning (Hartikainen et al. 2019), with the distance of a Euclidean z.
    """
    z = [model.encode(x).mu for x in sample.x]
    error = (_norm(z[2] - z[0]) - sample.duration) ** 2
    return {"bound": _read_out(model, sample.x) - error, "distance_error": error}


def random(model: PlanSpaceModel, sample: Sample, config: ObjectiveConfig, key: Key[Array, ""]) -> Terms:
    """The encoder as it was drawn; only the decoder learns."""
    return {"bound": _read_out(model, sample.x)}


OBJECTIVES: dict[ObjectiveName, Objective] = {
    "variational": variational,
    "shuffled": variational,  # on triplets whose members come from different demonstrations: see `fit`
    "direct": direct,
    "vae": vae,
    "e2c": e2c,
    "straightening": straightening,
    "distance": distance,
    "random": random,
}
"""Those that are trained. `pca` has a closed form: see `fit`."""


def between(
    q_a: DiagonalGaussian, q_b: DiagonalGaussian, w: Float[Array, ""], *, double_variance: bool
) -> DiagonalGaussian:
    """The distribution of (1 - w) z_a + w z_b; for w = 1/2 the midpoint of equation 9.

    The variance of a mean of two is half of each; doubled, it matches q(z|x_t), to which it is compared
    (paper, section on the implementation). For any w, the variance is then interpolated like the mean.
    """
    mu = (1 - w) * q_a.mu + w * q_b.mu
    if double_variance:
        return DiagonalGaussian(mu, jnp.sqrt((1 - w) * q_a.sigma**2 + w * q_b.sigma**2))
    return DiagonalGaussian(mu, jnp.sqrt((1 - w) ** 2 * q_a.sigma**2 + w**2 * q_b.sigma**2))


def _balanced_kl(p: DiagonalGaussian, q: DiagonalGaussian, balance: float) -> Float[Array, ""]:
    """KL(p || q), whose gradient moves q by `balance` and p by the rest (Hafner et al. 2023), twice."""
    if balance == 0.5:
        return kl(p, q)
    stop = jax.lax.stop_gradient
    value = 2 * balance * kl(stop(p), q) + 2 * (1 - balance) * kl(p, stop(q))
    return value + stop(kl(p, q) - value)


def _curvature(z_a: Array, z_t: Array, z_b: Array) -> Float[Array, ""]:
    first, second = z_t - z_a, z_b - z_t
    return 1 - jnp.dot(first, second) / (_norm(first) * _norm(second))


def _norm(x: Float[Array, " dim"]) -> Float[Array, ""]:
    return jnp.sqrt(jnp.sum(x**2) + SMALL)


def _autoencode(
    model: PlanSpaceModel, x: Float[Array, " input"], key: Key[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Log p of a state given its own sample, and KL to the prior."""
    q = model.encode(x)
    return model.decode(q.sample(key=key)).log_prob(x), kl_to_prior(q)


def _read_out(model: PlanSpaceModel, x: Float[Array, "3 input"]) -> Float[Array, ""]:
    """Log p of the states given their z, for the decoder alone."""

    def one(x: Array) -> Array:
        return model.decode(jax.lax.stop_gradient(model.encode(x).mu)).log_prob(x)

    return jax.vmap(one)(x).sum()
