"""Compare distances between states with the shortest times between them, where those are known."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Bool, Float

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.rotations import find_quaternions, with_signs_of
from planspace.errors import PlanspaceError, UsageError
from planspace.physics.angles import wrap
from planspace.storage.checks import MAX_BYTES, check_file

KEYS = "`states`, `time` and `goals` or `goal`"
GROUPS = 10
"""Groups of pairs, sorted by distance, in which predicted and true times are compared."""


class Truth(NamedTuple):
    """Shortest times from states to goals."""

    states: Float[np.ndarray, "row state"]
    time: Float[np.ndarray, " row"]
    """The shortest time from each state to its goal [s]; 0 in the goal region."""
    goals: Float[np.ndarray, "row state"] | Float[np.ndarray, " state"]
    """The goal of each state, or one goal for all."""
    on_plans: Bool[np.ndarray, " row"] | None = None
    """Whether each state lies on a plan to its goal; None if it is not known."""


@dataclass(frozen=True)
class TimeAgreement:
    """How well a distance predicts the shortest time."""

    rank_correlation: float
    """Spearman correlation of the distance d with the shortest time t [1]; 0 if one of them is constant."""
    relative_error: float
    """Median of |c d - t| / t over pairs with t > 0, where c is `scale` [0]."""
    scale: float
    """c, in seconds per unit of distance: the median of c d / t over all pairs is 1. A distance in seconds
    has c = 1."""
    predicted: tuple[float, ...]
    """Mean of c d [s] in each tenth of the pairs, from the smallest to the largest distance."""
    true: tuple[float, ...]
    """Mean of t [s] in the same tenths."""
    num_pairs: int
    """Number of pairs."""


TrueTimes = Mapping[str, Mapping[str, TimeAgreement]]
"""By subset (`all`, `on_plans`, `off_plans`), then by distance (`z`, `raw_state`, `time_to_go`)."""


def compare_with_truth(embedding: Embedding, demos: Demos, train: np.ndarray, truth: Truth) -> TrueTimes:
    """Compare several distances with the shortest times.

    The distances are |z(a) - z(b)|, the distance of the raw states, standardised by the training split, with
    angles on the circle and any sign of a quaternion, and the embedding's own time to go if it has one.

    Args:
        embedding: the embedding.
        demos: demonstrations with the columns of `truth`.
        train: the demonstrations that standardise the raw state.
        truth: the shortest times, as `check_truth` returns them.
    """
    read = list(embedding.columns_of(demos.info.names))
    states, goals = truth.states[:, read], truth.goals[:, read]
    distances = {"z": embedding.distance(states, goals)}
    std = demos.states[demos.rows(train)].std(axis=0)
    quaternions = find_quaternions(demos.info, demos.info.names)
    difference = with_signs_of(truth.states, truth.goals, quaternions) - truth.goals
    circles = list(demos.info.circular_columns)
    difference[:, circles] = wrap(difference[:, circles])
    distances["raw_state"] = np.linalg.norm((difference / np.where(std > 0, std, 1.0))[:, read], axis=1)
    scales = {name: scale_to_time(d, truth.time) for name, d in distances.items()}
    if (seconds := _time_to_go(embedding, states, goals)) is not None:
        distances["time_to_go"], scales["time_to_go"] = seconds, 1.0
    return {
        subset: {name: agreement(d[rows], truth.time[rows], scales[name]) for name, d in distances.items()}
        for subset, rows in _subsets(truth).items()
    }


def agreement(
    distance: Float[np.ndarray, " row"], time: Float[np.ndarray, " row"], scale: float
) -> TimeAgreement:
    """Compare distances with shortest times.

    Args:
        distance: the distance of each pair.
        time: the shortest time of each pair [s].
        scale: seconds per unit of distance.
    """
    predicted, apart = scale * distance, time > 0
    errors = np.abs(predicted[apart] - time[apart]) / time[apart]
    groups = np.array_split(np.argsort(distance, kind="stable"), min(GROUPS, len(time)))
    return TimeAgreement(
        rank_correlation=rank_correlation(distance, time),
        relative_error=float(np.median(errors)) if len(errors) else 0.0,
        scale=scale,
        predicted=tuple(float(predicted[rows].mean()) for rows in groups),
        true=tuple(float(time[rows].mean()) for rows in groups),
        num_pairs=len(time),
    )


def scale_to_time(distance: Float[np.ndarray, " row"], time: Float[np.ndarray, " row"]) -> float:
    """The c for which the median of c d / t over pairs with t > 0 is 1; 0 if that median is 0 for all c."""
    apart = time > 0
    median = float(np.median(distance[apart] / time[apart]))
    return 1.0 / median if median > 0 else 0.0


def rank_correlation(a: Float[np.ndarray, " row"], b: Float[np.ndarray, " row"]) -> float:
    """Spearman correlation; 0 if all values of `a` or of `b` are equal."""
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(scipy.stats.spearmanr(a, b).statistic)


def load_truth(path: Path, columns: tuple[str, ...]) -> Truth:
    """Load shortest times from an .npz with `states`, `time`, `goals` or `goal`, and perhaps `on_plans`.

    Raises:
        PlanspaceError: the file cannot be read, lacks an array, or has arrays that `check_truth` refuses.
    """
    check_file(path, most=MAX_BYTES, may_be_link=True)
    try:
        with open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
            goals = file["goals" if "goals" in file else "goal"]
            states, time, goals = (np.asarray(a, dtype=float) for a in (file["states"], file["time"], goals))
            on_plans = file.get("on_plans")
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile) as error:
        raise PlanspaceError(f"{path} is not an .npz with {KEYS}: {' '.join(str(error).split())}") from None
    try:
        return check_truth(Truth(states, time, goals, on_plans), columns)
    except UsageError as error:
        raise PlanspaceError(f"{path}: {error}") from error


def check_truth(truth: Truth, columns: tuple[str, ...]) -> Truth:
    """Check shapes and numbers of shortest times, and return them with a goal for each state.

    Raises:
        UsageError: an array has the wrong shape or type, a number is not finite, a time is negative, or all
            times are equal.
    """
    states, time, goals, on_plans = truth.states, truth.time, truth.goals, truth.on_plans
    n = len(columns)
    if time.ndim != 1 or states.shape != (len(time), n) or goals.shape not in ((n,), states.shape):
        raise UsageError(
            f"`states` must be [n, {n}] ({', '.join(columns)}), `time` [n], and `goals` [n, {n}] or "
            f"`goal` [{n}]; got {states.shape}, {time.shape} and {goals.shape}."
        )
    if on_plans is not None and (on_plans.shape != time.shape or on_plans.dtype != bool):
        raise UsageError(
            f"`on_plans` must be {len(time)} truth values (bool), got {on_plans.dtype} {on_plans.shape}."
        )
    if not all(np.isfinite(a).all() for a in (states, time, goals)):
        raise UsageError("the shortest times contain a number that is not finite.")
    if len(np.unique(time)) < 2:
        raise UsageError("`time` needs at least two different times for a correlation.")
    if time.min() < 0:
        raise UsageError(f"`time` must not be negative, got {time.min():g}.")
    return Truth(states, time, np.broadcast_to(goals, states.shape), on_plans)


def _subsets(truth: Truth) -> dict[str, np.ndarray]:
    """All rows and, if it is known, those on plans and off them."""
    subsets = {"all": np.ones(len(truth.time), dtype=bool)}
    if truth.on_plans is not None:
        subsets |= {"on_plans": truth.on_plans, "off_plans": ~truth.on_plans}
    return {name: rows for name, rows in subsets.items() if rows.any()}


def _time_to_go(embedding: Embedding, states: np.ndarray, goals: np.ndarray) -> np.ndarray | None:
    """The embedding's own estimate [s]; None if it has none."""
    try:
        return np.asarray(embedding.time_to_go(states, goals), dtype=float)
    except PlanspaceError:
        return None
