"""The region that the demonstrations cover; outside it, z is a guess. NumPy only."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from planspace.errors import PlanspaceError

NUM_POINTS = 2000
QUANTILE = 0.99
"""Fraction of the validation states that lie inside, by definition."""
BLOCK = 500
"""Number of states compared with all points at once, to limit memory."""


@dataclass(frozen=True)
class Support:
    """A sample of training states. A state farther from all of them than `radius` is outside."""

    points: Float[np.ndarray, "point input"]
    """Inputs of training states, divided by `scale`."""
    scale: Float[np.ndarray, " input"]
    """Standard deviation of each input over the training states."""
    radius: float
    """Largest distance to the nearest point that counts as inside, in standard deviations."""

    @classmethod
    def fit(
        cls,
        train: Float[np.ndarray, "row input"],
        validation: Float[np.ndarray, "other_row input"],
        rng: np.random.Generator,
    ) -> "Support":
        """Draw points from the training inputs; the radius includes 99 % of the validation inputs."""
        std = train.std(axis=0)
        scale = np.where(std > 0, std, 1.0)
        chosen = rng.permutation(len(train))[:NUM_POINTS]
        points = train[chosen] / scale
        radius = float(np.quantile(_nearest(points, validation / scale), QUANTILE))
        return cls(points, scale, radius)

    def outside(self, inputs: Float[np.ndarray, "*batch input"]) -> Bool[np.ndarray, "*batch"]:
        """Tell which inputs lie outside.

        Raises:
            PlanspaceError: a number is not finite.
        """
        return np.asarray(self.distance(inputs) > self.radius)

    def distance(self, inputs: Float[np.ndarray, "*batch input"]) -> Float[np.ndarray, "*batch"]:
        """Distance of each input from the nearest point, in standard deviations.

        Raises:
            PlanspaceError: a number is not finite.
        """
        if not np.isfinite(inputs).all():
            raise PlanspaceError("a state contains a number that is not finite.")
        flat = (inputs / self.scale).reshape(-1, inputs.shape[-1])
        return _nearest(self.points, flat).reshape(inputs.shape[:-1])


def _nearest(points: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Distance of each x to the nearest point. Centring avoids differences of large squares."""
    centre = points.mean(axis=0)
    points, x = points - centre, x - centre
    squares = np.sum(points**2, axis=1)
    distances = [
        np.min(squares - 2 * block @ points.T, axis=1) + np.sum(block**2, axis=1)
        for block in np.split(x, np.arange(BLOCK, len(x), BLOCK))
    ]
    return np.sqrt(np.maximum(np.concatenate(distances), 0.0))
