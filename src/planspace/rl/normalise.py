"""Standardises observations by the mean and standard deviation that each seed has seen so far.

With `clone` above 0, those of the plans are used throughout. If mean and standard deviation changed, the
cloned policy would change with them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

BOUND = 10.0
"""Standardised observations are clipped to this."""
LEAST_VARIANCE = 1e-8
"""Added to the variance, so that it is never divided by 0."""
CONSTANT = 1e-4
"""A number does not vary in plans if its standard deviation is at most this, or this fraction of its mean."""


class ObsStatistics(NamedTuple):
    """Count, mean and sum of squared differences from the mean, for each number of an observation.

    They belong to one seed or, with a leading axis, to several.
    """

    num: Float[np.ndarray, "*seed"]
    mean: Float[np.ndarray, "*seed obs"]
    squares: Float[np.ndarray, "*seed obs"]

    @classmethod
    def empty(cls, num_obs: int) -> "ObsStatistics":
        """Statistics of no observation; they leave observations unchanged."""
        return cls(np.zeros(()), np.zeros(num_obs), np.zeros(num_obs))

    @classmethod
    def of(cls, obs: Float[np.ndarray, "sample obs"]) -> "ObsStatistics":
        """Statistics of these observations. A number that does not vary gets the standard deviation 1."""
        found = cls.empty(obs.shape[-1]).with_more(obs)
        least = CONSTANT * np.maximum(1.0, np.abs(found.mean))
        constant = found.squares <= found.num * least**2
        return found._replace(squares=np.where(constant, found.num, found.squares))

    @classmethod
    def stacked(cls, parts: "Sequence[ObsStatistics]") -> "ObsStatistics":
        """Statistics of several seeds, with a leading axis."""
        return cls(*map(np.stack, zip(*parts, strict=True)))

    @property
    def std(self) -> Float[np.ndarray, "*seed obs"]:
        """Standard deviation of each number; there must be at least one observation."""
        return np.sqrt(self.squares / self.num[..., None] + LEAST_VARIANCE)

    def with_more(self, obs: Float[np.ndarray, "*seed sample obs"]) -> "ObsStatistics":
        """Statistics that include these observations.

        Source: Chan, Golub and LeVeque 1979, the parallel form of the sums.
        """
        more, obs = obs.shape[-2], obs.astype(np.float64)
        mean = obs.mean(axis=-2)
        squares = np.sum((obs - mean[..., None, :]) ** 2, axis=-2)
        total = np.asarray(self.num + more)
        shift = mean - self.mean
        fraction = (more / total)[..., None]
        return ObsStatistics(
            total,
            self.mean + shift * fraction,
            self.squares + squares + shift**2 * self.num[..., None] * fraction,
        )

    def __call__(self, obs: Float[np.ndarray, "*seed sample obs"]) -> Float[np.ndarray, "*seed sample obs"]:
        """Standardise observations."""
        if not self.num.any():
            return obs
        shifted = (obs - self.mean[..., None, :]) / self.std[..., None, :]
        return np.clip(shifted, -BOUND, BOUND).astype(obs.dtype)
