"""What demonstrations can support: how finely, smoothly and directly they move. NumPy only.

States are compared in standard deviations of each number, so units make no difference.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Demos
from planspace.embed.geometry import MIDPOINT_SPACINGS

MAX_EXAMINED = 100
"""Only this many demonstrations are examined, spread over the dataset."""
FACTORS = (1, 2, 4, 8, 16, 32)
MIN_STEPS = 10
"""A path is compared at two rates if it has at least this many steps at the lower one."""
VISITED_POINTS, NEAR, FAR = 150, 0.05, 0.25
"""A state is visited again if the path leaves its neighbourhood by `FAR` and later comes back to `NEAR`, both
as fractions of the largest distance on the path. So many points of a path are compared."""
STILL = 0.01
"""A step shorter than this fraction of the mean step is a pause."""
Path = Float[np.ndarray, "_time state"]


@dataclass(frozen=True)
class DemoQuality:
    """Properties of demonstrations, as medians over demonstrations."""

    num_demos: int
    """Number of demonstrations in the dataset."""
    num_states: int
    """States per demonstration."""
    step_s: float
    """Time between states [s]."""
    length_kept: Mapping[int, float]
    """By k = 1, 2, 4, ...: the fraction of the length of the path through each k-th state that remains if
    every second of them is left out. 1 is smooth; noise keeps 0.5, and a random walk 0.71."""
    revisiting: float
    """Fraction of the states that a demonstration visits again after leaving them."""
    standing_still: float
    """Fraction of the steps that hardly move."""
    off_goal: int | None
    """Number of demonstrations that do not end at their goal; None if no goal is known."""

    @property
    def spacings_s(self) -> tuple[float, ...]:
        """Times from a state to the next one of a triplet of the midpoint error [s]."""
        return tuple(spacing * self.step_s for spacing in MIDPOINT_SPACINGS)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return asdict(self) | {"spacings_s": self.spacings_s}


def examine(demos: Demos) -> DemoQuality:
    """Examine the states of demonstrations, without an embedding."""
    chosen = np.unique(np.linspace(0, len(demos) - 1, MAX_EXAMINED).round().astype(int))
    episodes = [demos.episode(int(i)) for i in chosen]
    std = np.concatenate([e.states for e in episodes]).std(axis=0)
    paths = [e.states / np.where(std > 0, std, 1.0) for e in episodes]
    known = np.isfinite(demos.goals).all(axis=1)
    return DemoQuality(
        num_demos=len(demos),
        num_states=int(np.median(np.diff(demos.offsets))),
        step_s=float(np.median(np.concatenate([np.diff(e.times) for e in episodes]))),
        length_kept=_length_kept(paths),
        revisiting=float(np.median([_revisiting(path) for path in paths])),
        standing_still=float(np.median([_standing_still(path) for path in paths])),
        off_goal=int((known & ~demos.success.astype(bool)).sum()) if known.any() else None,
    )


def _length_kept(paths: Sequence[Path]) -> dict[int, float]:
    found = {}
    for factor in FACTORS:
        ratios = [ratio for path in paths if (ratio := _kept_at_half_rate(path[::factor])) is not None]
        if ratios:
            found[factor] = float(np.median(ratios))
    return found


def _kept_at_half_rate(path: Path) -> float | None:
    """None for a path that is too short or does not move."""
    path = path[: (len(path) - 1) // 2 * 2 + 1]
    length = _steps(path).sum()
    if len(path) < 2 * MIN_STEPS + 1 or length == 0:
        return None
    return float(_steps(path[::2]).sum() / length)


def _revisiting(path: Path) -> float:
    points = path[np.unique(np.linspace(0, len(path) - 1, VISITED_POINTS).round().astype(int))]
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    largest = distance.max()
    later = np.triu(distance)
    left = np.maximum.accumulate(later, axis=1) > FAR * largest
    after = np.triu(np.ones(distance.shape, dtype=bool))
    return float((left & after & (distance < NEAR * largest)).any(axis=1).mean())


def _standing_still(path: Path) -> float:
    steps = _steps(path)
    return float((steps <= STILL * steps.mean()).mean()) if len(steps) else 0.0


def _steps(path: Path) -> np.ndarray:
    return np.linalg.norm(np.diff(path, axis=0), axis=1)
