"""An untrained encoder, to compare with."""

from dataclasses import dataclass
from typing import ClassVar

from planspace.embed.objective import Key, Loss, Objective, PlanSpaceModel, Sample


@dataclass(frozen=True)
class RandomEncoder(Objective):
    """An encoder with random weights; only the decoder is trained."""

    name: ClassVar[str] = "random"

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """Zero: training only fits the decoder to z."""
        return 0.0
