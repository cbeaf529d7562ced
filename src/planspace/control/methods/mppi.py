"""Model predictive path integral control (MPPI): a mean of all candidates, weighted by their costs.

Source: Williams et al. 2017, Information-theoretic model predictive control. The temperature here is relative
to the spread of the costs, so that it needs no tuning when costs change their scale.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planspace.errors import check_setting


@dataclass(frozen=True)
class MPPI:
    """MPPI: the mean of all candidates, weighted by the exponential of their costs."""

    name: ClassVar[str] = "mppi"
    iterations: int = 1
    """Rounds of samples for each control step."""
    temperature: float = 0.1
    """Difference of cost at which a weight falls by e, relative to the standard deviation of the costs."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_setting("iterations", self.iterations, self.iterations >= 1, "at least 1")
        check_setting("temperature", self.temperature, self.temperature > 0, "above 0")

    def improve(
        self, std: np.ndarray, candidates: np.ndarray, costs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted mean."""
        finite = np.isfinite(costs)
        if not finite.any():
            return candidates[0], std
        excess = costs - costs[finite].min()
        spread = costs[finite].std() or 1.0
        weights = np.where(finite, np.exp(-np.where(finite, excess, 0.0) / (self.temperature * spread)), 0.0)
        return np.einsum("s,skc->kc", weights / weights.sum(), candidates), std
