"""Triplets of states along demonstrations: the training data of an embedding."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from planspace.demos.dataset import Demos
from planspace.demos.stored import StoredDemos
from planspace.errors import PlanspaceError


def triplet_rows(
    demos: Demos, episodes: Int[np.ndarray, " demo"], spacings: Sequence[int]
) -> Int[np.ndarray, "triplet 3"]:
    """All triplets (t - s, t, t + s) with the given spacings s.

    Args:
        demos: the dataset.
        episodes: the numbers of the demonstrations to use.
        spacings: the spacings s, in steps.

    Returns:
        Row numbers in `demos.states`.

    Raises:
        PlanspaceError: all demonstrations are too short for all spacings.
    """
    parts = []
    for i in episodes:
        first, last = int(demos.offsets[i]), int(demos.offsets[i + 1])
        for spacing in (s for s in spacings if 2 * s < last - first):
            start = np.arange(first, last - 2 * spacing)
            parts.append(np.stack([start, start + spacing, start + 2 * spacing], axis=1))
    if not parts:
        longest = int(np.diff(demos.offsets)[episodes].max())
        raise PlanspaceError(
            f"the longest demonstration has {longest} states, too few for a triplet with one of the "
            f"spacings {list(spacings)}: a spacing of s steps needs 2 s + 1 states."
        )
    return np.concatenate(parts)


def random_triplets(
    demos: Demos | StoredDemos,
    episodes: Int[np.ndarray, " demo"],
    num: int,
    rng: np.random.Generator,
    short_fraction: float = 0.0,
) -> Int[np.ndarray, "triplet 3"]:
    """Draw triplets a < t < b that span up to a whole demonstration.

    The middle t is drawn uniformly from all states except the first and last of each demonstration. Then a
    and b are drawn uniformly from the states before and after t. For a fraction of the triplets, only the
    nearest states are used; their number is log-uniform between one state and all of them.

    Args:
        demos: the dataset. If it is a `StoredDemos`, only its offsets are loaded.
        episodes: the numbers of the demonstrations to use.
        num: number of triplets.
        rng: the random generator.
        short_fraction: fraction of the triplets that use only the nearest states, from 0 to 1.

    Returns:
        Row numbers in `demos.states`, or for `demos.states_at`.

    Raises:
        PlanspaceError: no demonstration has three states.
    """
    first, last = demos.offsets[episodes], demos.offsets[episodes + 1] - 1
    inner = np.cumsum(np.maximum(last - first - 1, 0))  # inner states up to the end of each one
    if len(inner) == 0 or inner[-1] == 0:
        raise PlanspaceError("no demonstration has the 3 states that a triplet needs.")
    drawn = rng.integers(inner[-1], size=num)
    chosen = np.searchsorted(inner, drawn, side="right")
    first, last = first[chosen], last[chosen]
    t = last - (inner[chosen] - drawn)
    before, after = t - first, last - t
    reach = np.maximum(before, after) ** -rng.uniform(size=num)  # fraction of the states on each side
    reach[rng.uniform(size=num) >= short_fraction] = 1.0
    a = rng.integers(t - np.ceil(reach * before).astype(int), t)
    b = rng.integers(t, t + np.ceil(reach * after).astype(int)) + 1
    return np.stack([a, t, b], axis=1)
