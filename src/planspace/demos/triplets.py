"""Triplets of states along demonstrations, the data the embedding is trained on."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from planspace.demos.dataset import Demos
from planspace.demos.stored import StoredDemos
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
    demos: Demos | StoredDemos,
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
        demos: the dataset; of one that is stored only the offsets are kept in memory.
        episodes: which demonstrations.
        num: how many triplets.
        rng: where the draws come from.
        near: of how many triplets the share is drawn, from 0 to 1.

    Returns:
        Row numbers into `demos.states`, or for `demos.states_at`.

    Raises:
        PlanspaceError: no demonstration has three states.
    """
    first, last = demos.offsets[episodes], demos.offsets[episodes + 1] - 1
    inner = np.cumsum(np.maximum(last - first - 1, 0))  # how many inner states up to each demonstration's end
    if len(inner) == 0 or inner[-1] == 0:
        raise PlanspaceError("no demonstration has the 3 states that a triplet needs.")
    drawn = rng.integers(inner[-1], size=num)
    chosen = np.searchsorted(inner, drawn, side="right")
    first, last = first[chosen], last[chosen]
    t = last - (inner[chosen] - drawn)
    before, after = t - first, last - t
    share = np.maximum(before, after) ** -rng.uniform(size=num)
    share[rng.uniform(size=num) >= near] = 1.0
    a = rng.integers(t - np.ceil(share * before).astype(int), t)
    b = rng.integers(t, t + np.ceil(share * after).astype(int)) + 1
    return np.stack([a, t, b], axis=1)
