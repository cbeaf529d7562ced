"""Embed to control, to compare with."""

from dataclasses import dataclass
from typing import ClassVar

from planspace.embed.objective import Key, Loss, Objective, PlanSpaceModel, Sample, check_weights
from planspace.embed.triplet_source import Triplets, TripletSource


@dataclass(frozen=True)
class EmbedToControl(Objective):
    """Embed to control: a control moves z by one step of dynamics that are linear at each z."""

    name: ClassVar[str] = "e2c"

    linearity: float = 8.0
    """Weight of the KL between the predicted next z and the encoded one."""
    prior: float = 0.1
    """Weight of the KL to the prior; high values lose dimensions of z."""

    def __post_init__(self) -> None:
        """Check the weights.

        Raises:
            UsageError: a weight is negative or not finite.
        """
        check_weights(linearity=self.linearity, prior=self.prior)

    def draw_triplets(self, source: TripletSource) -> Triplets:
        """Single steps: the dynamics predict one step."""
        return source.spaced((1,))

    def needs_controls(self) -> bool:
        """The dynamics need the control of the step."""
        return True

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """Minus the bound of two successive states x_a and x_t.

        Source: Watter et al. 2015, equations 8 to 12; A = I + v r^T, and its variance stays diagonal.
        """
        import jax.random as jr

        from planspace.embed.gaussian import kl, kl_to_prior

        assert model.transition is not None
        x_a, x_t, _ = sample.x
        q_a, q_t = model.encode(x_a), model.encode(x_t)
        a_key, next_key = jr.split(key)
        z_a = q_a.sample(key=a_key)
        q_next = model.transition(z_a, q_a, sample.control)
        z_next = q_next.sample(key=next_key)
        log_likelihood = model.decode(z_a).log_prob(x_a) + model.decode(z_next).log_prob(x_t)
        prior_kl, dynamics_kl = kl_to_prior(q_a), kl(q_next, q_t)
        bound = log_likelihood - self.prior * prior_kl - self.linearity * dynamics_kl
        terms = {"log_likelihood": log_likelihood, "prior_kl": prior_kl, "dynamics_kl": dynamics_kl}
        return -bound, terms
