"""Evenly spaced triplets of states along demonstrations, the data the embedding is trained on."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from planspace.demos.dataset import Demos
from planspace.errors import PlanspaceError

PAPER_SPACINGS = (1, 3, 5, 10, 30)
"""Steps between the members of a triplet (paper, section on the variational embedding)."""


def triplet_rows(
    demos: Demos, episodes: Int[np.ndarray, " demo"], spacings: Sequence[int] = PAPER_SPACINGS
) -> Int[np.ndarray, "triplet 3"]:
    """Every triplet (t - s, t, t + s) of the given spacings within the given demonstrations.

    Args:
        demos: the dataset.
        episodes: which demonstrations.
        spacings: the steps s.

    Returns:
        Row numbers into `demos.states`.

    Raises:
        PlanspaceError: every demonstration is too short for every spacing.
    """
    parts = []
    for i in episodes:
        first, last = int(demos.offsets[i]), int(demos.offsets[i + 1])
        for spacing in spacings:
            start = np.arange(first, last - 2 * spacing)
            parts.append(np.stack([start, start + spacing, start + 2 * spacing], axis=1))
    rows = np.concatenate(parts)
    if len(rows) == 0:
        longest = int(np.diff(demos.offsets)[episodes].max())
        raise PlanspaceError(
            f"the longest demonstration has {longest} states, too short for a triplet at any of the "
            f"spacings {list(spacings)}: a spacing of s steps needs 2 s + 1 states."
        )
    return rows
