"""Temporal straightening, to compare with."""

from dataclasses import dataclass
from typing import ClassVar

from planspace.embed.objective import Key, Loss, Objective, PlanSpaceModel, Sample, check_weights


@dataclass(frozen=True)
class Straightening(Objective):
    """A variational auto-encoder with a penalty on the curvature of paths in z."""

    name: ClassVar[str] = "straightening"

    linearity: float = 8.0
    """Weight of the curvature, 1 - cos of successive differences of z."""
    prior: float = 0.1
    """Weight of the KL to the prior; high values lose dimensions of z."""

    def __post_init__(self) -> None:
        """Check the weights.

        Raises:
            UsageError: a weight is negative or not finite.
        """
        check_weights(linearity=self.linearity, prior=self.prior)

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """Minus the bound of a variational auto-encoder, plus the weighted curvature.

        Source: temporal straightening (Wang et al. 2026). Their prediction loss keeps z from collapsing; here
        the reconstruction does, which needs no controls.
        """
        from planspace.embed import losses

        loss, terms = losses.autoencoder_loss(model, sample.x, self.prior, key=key)
        curvature = losses.curvature(*(model.encode(x).mu for x in sample.x))
        return loss + self.linearity * curvature, {**terms, "curvature": curvature}
