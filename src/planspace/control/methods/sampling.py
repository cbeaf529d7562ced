"""Predictive sampling: the best candidate.

Source: Howell et al. 2022, Predictive Sampling: Real-time Behaviour Synthesis with MuJoCo.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planspace.errors import check_setting


@dataclass(frozen=True)
class Sampling:
    """Predictive sampling: apply the best candidate."""

    name: ClassVar[str] = "sampling"
    iterations: int = 1
    """Rounds of samples for each control step."""

    def __post_init__(self) -> None:
        """Check the range."""
        check_setting("iterations", self.iterations, self.iterations >= 1, "at least 1")

    def improve(
        self, std: np.ndarray, candidates: np.ndarray, costs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the best candidate."""
        return candidates[np.argmin(costs)], std
