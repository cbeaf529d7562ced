"""Observations standardised by what each seed has seen so far."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

BOUND = 10.0
"""Standardised observations are clipped to this."""
LEAST_VARIANCE = 1e-8


class ObsStatistics(NamedTuple):
    """How many, mean and sum of squared deviations of each number of an observation.

    Of one seed, or of many with an axis of seeds in front.
    """

    num: Float[np.ndarray, "*seed"]
    mean: Float[np.ndarray, "*seed obs"]
    squares: Float[np.ndarray, "*seed obs"]

    @classmethod
    def empty(cls, num_obs: int) -> "ObsStatistics":
        """Of nothing yet, which changes no observation."""
        return cls(np.zeros(()), np.zeros(num_obs), np.zeros(num_obs))

    @classmethod
    def stacked(cls, parts: "Sequence[ObsStatistics]") -> "ObsStatistics":
        """Those of several seeds, with an axis of seeds."""
        return cls(*map(np.stack, zip(*parts, strict=True)))

    def with_more(self, obs: Float[np.ndarray, "*seed sample obs"]) -> "ObsStatistics":
        """Of these observations as well.

        Source: Chan, Golub and LeVeque 1979, the parallel form of the sums.
        """
        more, obs = obs.shape[-2], obs.astype(np.float64)
        mean = obs.mean(axis=-2)
        squares = np.sum((obs - mean[..., None, :]) ** 2, axis=-2)
        total = np.asarray(self.num + more)
        shift = mean - self.mean
        share = (more / total)[..., None]
        return ObsStatistics(
            total,
            self.mean + shift * share,
            self.squares + squares + shift**2 * self.num[..., None] * share,
        )

    def __call__(self, obs: Float[np.ndarray, "*seed sample obs"]) -> Float[np.ndarray, "*seed sample obs"]:
        """The observations, standardised."""
        if not self.num.any():
            return obs
        deviation = np.sqrt(self.squares / self.num[..., None] + LEAST_VARIANCE)
        shifted = (obs - self.mean[..., None, :]) / deviation[..., None, :]
        return np.clip(shifted, -BOUND, BOUND).astype(obs.dtype)
