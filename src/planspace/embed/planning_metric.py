"""An embedding as the metric of a planner; see `plan.metric`."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import Embedding


@dataclass(frozen=True)
class PlanningMetric:
    """The time to go that an embedding estimates, or without a time head its distance in z."""

    name: ClassVar[str] = "embedding"

    embedding: Embedding
    columns: tuple[int, ...]
    """Where a planner's states have the numbers that the embedding reads."""

    @property
    def hash(self) -> str:
        """The hash of the embedding's content."""
        return self.embedding.hash

    def __call__(
        self, states: Float[np.ndarray, "batch state"], goals: Float[np.ndarray, "batch state"]
    ) -> Float[np.ndarray, " batch"]:
        """How far each state is from its goal [s, or distance in z]."""
        measure = self.embedding.distance if self.embedding.time_head is None else self.embedding.time_to_go
        return measure(states[:, self.columns], goals[:, self.columns])
