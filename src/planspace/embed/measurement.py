"""Measure an embedding: geometry of each split, baselines and checks. `planspace measure` prints it."""

import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.embed.about import SPLITS
from planspace.embed.embedding import Embedding
from planspace.embed.geometry import (
    Geometry,
    Interval,
    bootstrap_intervals,
    measure_constant,
    measure_raw_state,
    summarise,
    tabulate,
)
from planspace.embed.inputs import check_numbers
from planspace.errors import PlanspaceError, UsageError
from planspace.progress import progress, progress_shown
from planspace.storage.checks import MAX_BYTES, check_file
from planspace.summary import html_summary, text_summary

TRUTH_KEYS = ("states", "time", "goal")


@dataclass(frozen=True)
class SplitMeasurement:
    """The geometry of a set of demonstrations, and of two baselines."""

    embedding: Geometry
    """The geometry in z."""
    intervals: Mapping[str, Interval]
    """The 95 % interval of each metric of z over demonstrations."""
    raw_state: Geometry
    """The geometry of the raw state, standardised by the training split."""
    constant: Geometry
    """The geometry of a constant z."""


@dataclass(frozen=True)
class Checks:
    """What the geometry along demonstrations does not show; None if a check does not apply."""

    change_by_a_turn: float | None = None
    """Largest distance by which z moves if an angle on a circle changes by 2 pi, in standard deviations of z;
    the ideal is 0."""
    outside_support: float | None = None
    """Fraction of the states that lie outside the region that the training demonstrations cover."""
    true_time_correlation: float | None = None
    """Spearman correlation of |z - z_goal| with the shortest time to the goal."""


@dataclass(frozen=True, repr=False)
class Measurement:
    """Everything that is measured of an embedding."""

    splits: Mapping[str, SplitMeasurement]
    """By split: `train`, `validation` and `test` of the demonstrations it was trained on; otherwise `all`."""
    checks: Checks = field(default_factory=Checks)

    def to_dict(self) -> dict[str, Any]:
        """Return the measurement as plain data for JSON; checks that do not apply are left out."""
        checks = {name: value for name, value in asdict(self.checks).items() if value is not None}
        return {"splits": {name: asdict(part) for name, part in self.splits.items()}, "checks": checks}

    def __repr__(self) -> str:
        """A few lines: the metrics of the last split, and the checks."""
        return text_summary(*self._summary())

    def _repr_html_(self) -> str:
        return html_summary(*self._summary())

    def _summary(self) -> tuple[str, dict[str, str]]:
        name, part = list(self.splits.items())[-1]
        z, raw = asdict(part.embedding), asdict(part.raw_state)
        rows = {
            metric.replace("_", " "): f"{z[metric]:.3f} ({raw[metric]:.3f})"
            for metric in ("straightness", "midpoint_error", "time_correlation", "decoded_error")
        }
        checks = {n.replace("_", " "): f"{v:.3g}" for n, v in self.to_dict()["checks"].items()}
        splits = f", {name} split" if name in SPLITS else ""
        title = f"Measurement on {z['num_demos']} demonstrations{splits}: z (raw state)"
        return title, rows | checks


class Truth(NamedTuple):
    """Shortest times to a goal."""

    states: Float[np.ndarray, "row state"]
    time: Float[np.ndarray, " row"]
    """The shortest time from each state to the goal [s]."""
    goal: Float[np.ndarray, " state"]


def measure_embedding(
    embedding: Embedding,
    demos: Demos,
    *,
    truth: str | Path | Truth | None = None,
    verbose: bool = True,
) -> Measurement:
    """Measure an embedding on demonstrations.

    Args:
        embedding: the embedding.
        demos: the demonstrations; if it was trained on them, each split is measured separately.
        truth: shortest times to a goal, or an .npz with `states` [n, state], `time` [n] and `goal` [state];
            the columns are those of the demonstrations.
        verbose: show a progress bar.

    Raises:
        PlanspaceError: the demonstrations lack a state that the embedding reads, numbers are too large to
            compute with, or `truth` or the embedding's own split does not fit.
    """
    used = demos.select(embedding.inputs.names)
    check_numbers("the demonstrations' states", used.states)
    with np.errstate(over="ignore", invalid="ignore"):  # the check finds what is not finite
        z = embedding.encode(used.states)
        check_numbers("z of these states, or the states decoded from it,", z, embedding.decode(z))
    splits = split_of(embedding, demos)
    reference = splits.get("train", np.arange(len(demos)))
    if truth is not None:
        truth = (
            check_truth(truth, demos.info.names)
            if isinstance(truth, Truth)
            else load_truth(Path(truth), demos.info.names)
        )
    checks = run_checks(embedding, used, truth, demos.info.names)
    measured: dict[str, SplitMeasurement] = {}
    with progress_shown(verbose), progress("measure", len(splits), unit="split") as bar:
        for name, part in splits.items():
            measured[name] = _measure_split(embedding, used, part, reference)
            bar.update()
    return Measurement(measured, checks)


def split_of(embedding: Embedding, demos: Demos) -> dict[str, np.ndarray]:
    """Return the splits of the training if these are its demonstrations; otherwise one split, `all`.

    Raises:
        PlanspaceError: the embedding does not assign each demonstration of its training to exactly one split.
    """
    about = embedding.about
    if about is None or about.settings.demos != demos.hash:
        return {"all": np.arange(len(demos))}
    assigned = sorted(i for part in about.split.values() for i in part)
    if assigned != list(range(len(demos))) or not all(map(len, about.split.values())):
        raise PlanspaceError(
            f"the embedding was trained on these {len(demos)} demonstrations, but its file does not assign "
            f"each of them to one of {', '.join(SPLITS)}: the file was altered. Train the embedding again."
        )
    return {name: np.array(about.split[name]) for name in SPLITS}


def run_checks(embedding: Embedding, demos: Demos, truth: Truth | None, columns: tuple[str, ...]) -> Checks:
    """Run the checks that apply.

    Args:
        embedding: the embedding.
        demos: demonstrations with the states that the embedding reads.
        truth: shortest times to a goal, if they are known.
        columns: the columns of `truth`.
    """
    z = embedding.encode(demos.states)
    change = outside = correlation = None
    circles = embedding.inputs.circular_columns
    if circles:
        turns = 2 * np.pi * np.eye(demos.states.shape[1])
        moved = [np.linalg.norm(embedding.encode(demos.states + turns[c]) - z, axis=1).max() for c in circles]
        change = float(max(moved) / np.linalg.norm(z.std(axis=0)))
    if embedding.support is not None:
        outside = float(embedding.outside_support(demos.states).mean())
    if truth is not None:
        read = list(embedding.columns_of(columns))
        correlation = true_time_correlation(embedding, truth.states[:, read], truth.time, truth.goal[read])
    return Checks(change, outside, correlation)


def true_time_correlation(
    embedding: Embedding,
    states: Float[np.ndarray, "row state"],
    time: Float[np.ndarray, " row"],
    goal: Float[np.ndarray, " state"],
) -> float:
    """Spearman correlation of |z - z_goal| with the shortest time to the goal."""
    return float(scipy.stats.spearmanr(embedding.distance(states, goal), time).statistic)


def load_truth(path: Path, columns: tuple[str, ...]) -> Truth:
    """Load shortest times to a goal from an .npz with `states`, `time` and `goal`.

    Raises:
        PlanspaceError: the file cannot be read, lacks an array, or has arrays of the wrong shape.
    """
    check_file(path, most=MAX_BYTES, may_be_link=True)
    try:
        with open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
            truth = Truth(*(np.asarray(file[key], dtype=float) for key in TRUTH_KEYS))
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile) as error:
        raise PlanspaceError(
            f"{path} is not an .npz with `states`, `time` and `goal`: {' '.join(str(error).split())}"
        ) from None
    try:
        return check_truth(truth, columns)
    except UsageError as error:
        raise PlanspaceError(f"{path}: {error}") from error


def check_truth(truth: Truth, columns: tuple[str, ...]) -> Truth:
    """Check shapes and numbers of shortest times, and return them.

    Raises:
        UsageError: an array has the wrong shape, a number is not finite, or all times are equal.
    """
    states, time, goal = truth
    n = len(columns)
    if time.ndim != 1 or states.shape != (len(time), n) or goal.shape != (n,):
        raise UsageError(
            f"`states` must be [n, {n}] ({', '.join(columns)}), `time` [n] and `goal` [{n}]; got "
            f"{states.shape}, {time.shape} and {goal.shape}."
        )
    if not all(np.isfinite(a).all() for a in truth):
        raise UsageError("the shortest times contain a number that is not finite.")
    if len(np.unique(time)) < 2:
        raise UsageError("`time` needs at least two different times for a correlation.")
    return truth


def _measure_split(
    embedding: Embedding, demos: Demos, part: Int[np.ndarray, " demo"], reference: np.ndarray
) -> SplitMeasurement:
    table = tabulate(embedding, demos, part)
    return SplitMeasurement(
        summarise(table),
        bootstrap_intervals(table),
        measure_raw_state(demos, part, reference),
        measure_constant(demos, part),
    )
