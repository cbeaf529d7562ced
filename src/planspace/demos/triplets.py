"""Triplets of states along demonstrations, the data the embedding is trained on."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from planspace.demos.dataset import Demos
from planspace.errors import PlanspaceError


def triplet_rows(
    demos: Demos, episodes: Int[np.ndarray, " demo"], spacings: Sequence[int]
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
        for spacing in (s for s in spacings if 2 * s < last - first):
            start = np.arange(first, last - 2 * spacing)
            parts.append(np.stack([start, start + spacing, start + 2 * spacing], axis=1))
    if not parts:
        longest = int(np.diff(demos.offsets)[episodes].max())
        raise PlanspaceError(
            f"the longest demonstration has {longest} states, too short for a triplet at any of the "
            f"spacings {list(spacings)}: a spacing of s steps needs 2 s + 1 states."
        )
    return np.concatenate(parts)


def random_triplets(
    demos: Demos,
    episodes: Int[np.ndarray, " demo"],
    num: int,
    rng: np.random.Generator,
    near: float = 0.0,
) -> Int[np.ndarray, "triplet 3"]:
    """Triplets a < t < b of any length within the given demonstrations, up to a whole one.

    t is drawn from all states but the first and last of a demonstration, so that each counts the same; a and
    b then from a share of those before and of those after it. The share is 1, or, for some of the triplets,
    log-uniform from the nearest state alone to all.

    Args:
        demos: the dataset.
        episodes: which demonstrations.
        num: how many triplets.
        rng: where the draws come from.
        near: of how many triplets the share is drawn, from 0 to 1.

    Returns:
        Row numbers into `demos.states`.

    Raises:
        PlanspaceError: no demonstration has three states.
    """
    inner, first, last = [], [], []
    for i in episodes:
        a, b = int(demos.offsets[i]), int(demos.offsets[i + 1]) - 1
        inside = np.arange(a + 1, b)
        inner.append(inside)
        first.append(np.full(len(inside), a))
        last.append(np.full(len(inside), b))
    rows = np.stack([np.concatenate(part) for part in (first, inner, last)], axis=1)
    if len(rows) == 0:
        raise PlanspaceError("no demonstration has the 3 states that a triplet needs.")
    first, t, last = rows[rng.integers(len(rows), size=num)].T
    before, after = t - first, last - t
    share = np.maximum(before, after) ** -rng.uniform(size=num)
    share[rng.uniform(size=num) >= near] = 1.0
    a = rng.integers(t - np.ceil(share * before).astype(int), t)
    b = rng.integers(t, t + np.ceil(share * after).astype(int)) + 1
    return np.stack([a, t, b], axis=1)
