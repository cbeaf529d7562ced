"""The cross-entropy method (CEM): fit a Gaussian to the best candidates, several times for each step."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planspace.errors import check_setting


@dataclass(frozen=True)
class CEM:
    """CEM: the mean and the spread of the best candidates, in several rounds."""

    name: ClassVar[str] = "cem"
    iterations: int = 3
    """Rounds of samples for each control step."""
    elite_fraction: float = 0.1
    """Fraction of the candidates that the next distribution is fitted to."""
    min_std: float = 0.05
    """Least standard deviation of a knot, in halves of the control's range."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_setting("iterations", self.iterations, self.iterations >= 1, "at least 1")
        inside = 0 < self.elite_fraction <= 1
        check_setting("elite_fraction", self.elite_fraction, inside, "above 0 and at most 1")
        check_setting("min_std", self.min_std, self.min_std >= 0, "at least 0")

    def improve(
        self, std: np.ndarray, candidates: np.ndarray, costs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean and the standard deviation of the best candidates."""
        count = max(1, round(self.elite_fraction * len(candidates)))
        elite = candidates[np.argsort(costs, kind="stable")[:count]]
        return elite.mean(axis=0), np.maximum(elite.std(axis=0), self.min_std)
