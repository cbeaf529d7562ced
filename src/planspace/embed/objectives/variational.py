"""The paper's variational objective."""

from dataclasses import dataclass
from typing import ClassVar

from planspace.embed.objective import Key, Loss, Objective, PlanSpaceModel, Sample, check_weights
from planspace.errors import UsageError


@dataclass(frozen=True)
class Variational(Objective):
    """The paper's variational bound: z_t lies on the line from z_a to z_b."""

    name: ClassVar[str] = "variational"

    linearity: float = 8.0
    """lambda of equation 7: weight of the term that puts z_t on the line from z_a to z_b. The paper: 0.5."""
    prior: float = 0.1
    """Weight of the KL to the prior; high values lose dimensions of z. The paper: 1. (Below 1 it is the beta
    of Higgins et al. 2017.)"""
    double_variance: bool = True
    """Double the variance of z_hat, to match q(z|x_t) (paper, section on the implementation)."""
    balance: float = 0.5
    """Fraction of the linearity term's gradient that moves q_t; the rest moves q_a and q_b. 0.5 is the plain
    gradient."""
    curvature: float = 0.0
    """Weight of 1 - cos of the angle between z_t - z_a and z_b - z_t."""
    distance: float = 0.0
    """Weight of (|z_a - z_b| / s - time from a to b)^2. The unit of time is the mean duration of a
    demonstration; s is learned."""
    off_data_weight: float = 1.0
    """Weight of an auto-encoder's bound on states off the demonstrations: their numbers come from different
    demonstrations, in a range 1.5 times as wide. An agent also visits states that no plan visits."""

    def __post_init__(self) -> None:
        """Check the weights.

        Raises:
            UsageError: a weight is out of its range.
        """
        check_weights(
            linearity=self.linearity,
            prior=self.prior,
            curvature=self.curvature,
            distance=self.distance,
            off_data_weight=self.off_data_weight,
        )
        if not 0 <= self.balance <= 1:
            raise UsageError(f"`balance` must be between 0 and 1, got {self.balance}.")

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """Minus the variational bound of one triplet, from one sample of z (SGVB estimator B).

        Source: equation 7; the terms weighted by `curvature`, `distance` and `off_data_weight` are ours.
        """
        import jax.random as jr

        from planspace.embed import losses
        from planspace.embed.gaussian import kl_to_prior

        x_a, x_t, x_b = sample.x
        q_a, q_t, q_b = model.encode(x_a), model.encode(x_t), model.encode(x_b)
        q_mid = losses.between(q_a, q_b, sample.w, double_variance=self.double_variance)
        a_key, mid_key, b_key, off_data_key = jr.split(key, 4)
        z_a, z_hat, z_b = q_a.sample(key=a_key), q_mid.sample(key=mid_key), q_b.sample(key=b_key)
        log_likelihood = (
            model.decode(z_a).log_prob(x_a)
            + model.decode(z_hat).log_prob(x_t)
            + model.decode(z_b).log_prob(x_b)
        )
        prior_kl = kl_to_prior(q_a) + kl_to_prior(q_b)
        midpoint_kl = losses.balanced_kl(q_mid, q_t, self.balance)
        bound = log_likelihood - self.prior * prior_kl - self.linearity * midpoint_kl
        terms = {"log_likelihood": log_likelihood, "prior_kl": prior_kl, "midpoint_kl": midpoint_kl}
        if self.curvature:
            terms["curvature"] = losses.curvature(q_a.mu, q_t.mu, q_b.mu)
            bound -= self.curvature * terms["curvature"]
        if self.distance:
            terms["distance_error"] = (losses.length(q_b.mu - q_a.mu) / model.scale - sample.duration) ** 2
            bound -= self.distance * terms["distance_error"]
        if self.off_data_weight:
            log_p, divergence = losses.autoencode(model, sample.off_data, key=off_data_key)
            terms["off_data"] = log_p - self.prior * divergence
            bound += self.off_data_weight * terms["off_data"]
        return -bound, terms
