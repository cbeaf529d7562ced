"""The variational objective on shuffled triplets, to compare with."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planspace.embed.objectives.variational import Variational
from planspace.embed.triplet_source import Triplets, TripletSource


@dataclass(frozen=True)
class Shuffled(Variational):
    """The variational bound on triplets whose members come from different demonstrations."""

    name: ClassVar[str] = "shuffled"

    def draw_triplets(self, source: TripletSource) -> Triplets:
        """Permute each member over the triplets: the same states, but no plans; the times stay."""
        rows, times = source.standard()
        return Triplets(np.stack([source.rng.permutation(column) for column in rows.T], axis=1), times)
