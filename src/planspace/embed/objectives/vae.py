"""A variational auto-encoder, to compare with."""

from dataclasses import dataclass
from typing import ClassVar

from planspace.embed.objective import Key, Loss, Objective, PlanSpaceModel, Sample, check_weights


@dataclass(frozen=True)
class AutoEncoder(Objective):
    """A variational auto-encoder on the same states; it ignores that they form plans."""

    name: ClassVar[str] = "vae"

    prior: float = 0.1
    """Weight of the KL to the prior; high values lose dimensions of z."""

    def __post_init__(self) -> None:
        """Check the weight.

        Raises:
            UsageError: it is negative or not finite.
        """
        check_weights(prior=self.prior)

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """Minus the bound of a variational auto-encoder.

        Source: Kingma and Welling 2013, equation 10.
        """
        from planspace.embed import losses

        return losses.autoencoder_loss(model, sample.x, self.prior, key=key)
