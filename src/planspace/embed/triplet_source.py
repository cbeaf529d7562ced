"""The training demonstrations, from which an objective draws triplets of states."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.triplets import random_triplets, triplet_rows
from planspace.errors import PlanspaceError

NUM_RANDOM = 400_000
"""Triplets of random length that are drawn before training; batches are taken from them."""


class Triplets(NamedTuple):
    """Triplets of states (a, t, b)."""

    rows: Int[np.ndarray, "triplet 3"]
    """Rows of the demonstrations' states."""
    times: Float[np.ndarray, "triplet 3"]
    """Their times [s], increasing from a to t to b."""


@dataclass(frozen=True)
class TripletSource:
    """The training demonstrations, and how the settings say that triplets are drawn."""

    demos: Demos
    """All demonstrations."""
    train: Int[np.ndarray, " demo"]
    """Indices of those to train on."""
    spacings: tuple[int, ...]
    """Steps between the members of a triplet; empty draws any three states of a demonstration."""
    short_fraction: float
    """Fraction of the triplets of random length whose length is drawn log-uniformly."""
    rng: np.random.Generator
    """Random numbers for the draws."""

    def standard(self) -> Triplets:
        """Draw triplets as the settings say.

        Raises:
            PlanspaceError: the demonstrations are too short, or their times do not increase.
        """
        if self.spacings:
            return self.spaced(self.spacings)
        rows = random_triplets(self.demos, self.train, NUM_RANDOM, self.rng, self.short_fraction)
        return self._timed(rows)

    def spaced(self, spacings: tuple[int, ...]) -> Triplets:
        """Return every triplet of the given spacings, in steps.

        Raises:
            PlanspaceError: the demonstrations are too short, or their times do not increase.
        """
        return self._timed(triplet_rows(self.demos, self.train, spacings))

    def _timed(self, rows: Int[np.ndarray, "triplet 3"]) -> Triplets:
        times = self.demos.times[rows]
        if not (times[:, 2] > times[:, 0]).all():
            raise PlanspaceError("the times of a demonstration do not increase; see planspace demos show.")
        return Triplets(rows, times)
