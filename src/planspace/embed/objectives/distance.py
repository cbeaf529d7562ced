"""Regression on the time between states, to compare with."""

from dataclasses import dataclass
from typing import ClassVar

from planspace.embed.objective import Key, Loss, Objective, PlanSpaceModel, Sample


@dataclass(frozen=True)
class Distance(Objective):
    """Regression of |z_a - z_b| on the time from a to b, which the metrics of time reward directly."""

    name: ClassVar[str] = "distance"

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """The squared error of the distance; the unit of time is the mean duration of a demonstration.

        Source: dynamical distance learning (Hartikainen et al. 2019), with the distance of a Euclidean z.
        """
        from planspace.embed import losses

        x_a, _, x_b = sample.x
        error = (losses.length(model.encode(x_b).mu - model.encode(x_a).mu) - sample.duration) ** 2
        return error, {"distance_error": error}
