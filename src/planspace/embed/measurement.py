"""Measure an embedding: geometry of each split, baselines and checks. `planspace measure` prints it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from planspace.demos.dataset import Demos
from planspace.embed.about import SPLITS
from planspace.embed.demo_quality import DemoQuality, examine
from planspace.embed.embedding import Embedding
from planspace.embed.folds import measure_folds
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
from planspace.embed.rotations import find_quaternions
from planspace.embed.true_times import TrueTimes, Truth, check_truth, compare_with_truth, load_truth
from planspace.embed.verdict import Verdict, judge
from planspace.errors import PlanspaceError
from planspace.progress import progress, progress_shown
from planspace.seams import check_kind
from planspace.summary import html_summary, text_summary


@dataclass(frozen=True)
class SplitMeasurement:
    """The geometry of a set of demonstrations, and of two baselines."""

    embedding: Geometry
    """The geometry in z."""
    intervals: Mapping[str, Interval]
    """The 95 % interval of each metric of z over demonstrations; empty for one demonstration."""
    raw_state: Geometry
    """The geometry of the raw state, standardised by the training split."""
    constant: Geometry
    """The geometry of a constant z."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; a metric that cannot be measured is None."""
        return {
            "embedding": self.embedding.plain(),
            "intervals": dict(self.intervals),
            "raw_state": self.raw_state.plain(),
            "constant": self.constant.plain(),
            "not_available": self.embedding.missing(),
        }


@dataclass(frozen=True)
class Checks:
    """What the geometry along demonstrations does not show; None if a check does not apply."""

    change_by_a_turn: float | None = None
    """Largest distance by which z moves if an angle on a circle changes by 2 pi, in standard deviations of z;
    the ideal is 0."""
    change_by_a_sign: float | None = None
    """The same if the sign of a quaternion changes, which is the same rotation."""
    outside_support: float | None = None
    """Fraction of the states that lie outside the region that the training demonstrations cover."""
    true_time_correlation: float | None = None
    """Spearman correlation of |z - z_goal| with the shortest time to the goal, over all pairs."""


@dataclass(frozen=True, repr=False)
class Measurement:
    """Everything that is measured of an embedding."""

    splits: Mapping[str, SplitMeasurement]
    """By split: `train`, `validation` and `test` of the demonstrations it was trained on; otherwise `all`.
    Also `folds`, if they were asked for."""
    checks: Checks = field(default_factory=Checks)
    true_times: TrueTimes | None = None
    """How well distances predict the shortest times, if those are known."""
    demonstrations: DemoQuality | None = None
    """What the demonstrations are like; None if they were not examined."""
    verdict: Verdict | None = None
    """The measurement in words; None if there is none."""

    def to_dict(self) -> dict[str, Any]:
        """Return the measurement as plain data for JSON; what does not apply is left out."""
        checks = {name: value for name, value in asdict(self.checks).items() if value is not None}
        found: dict[str, Any] = {
            "splits": {name: part.to_dict() for name, part in self.splits.items()},
            "checks": checks,
        }
        if self.true_times is not None:
            found["true_times"] = {
                subset: {name: asdict(part) for name, part in distances.items()}
                for subset, distances in self.true_times.items()
            }
        if self.demonstrations is not None:
            found["demonstrations"] = self.demonstrations.to_dict()
        if self.verdict is not None:
            found["verdict"] = self.verdict.to_dict()
        return found

    def __repr__(self) -> str:
        """A few lines: the metrics of the last split, and the checks."""
        return text_summary(*self._summary())

    def _repr_html_(self) -> str:
        return html_summary(*self._summary())

    def _summary(self) -> tuple[str, dict[str, str]]:
        name, part = list(self.splits.items())[-1]
        z, raw = asdict(part.embedding), asdict(part.raw_state)
        rows = {
            metric.replace("_", " "): f"{z[metric]:.3f} ({raw[metric]:.3f})".replace("nan", "n/a")
            for metric in ("straightness", "midpoint_error", "time_correlation", "decoded_error")
        }
        checks = {n.replace("_", " "): f"{v:.3g}" for n, v in self.to_dict()["checks"].items()}
        for subset, times in (self.true_times or {}).items():
            shown = f"{times['z'].rank_correlation:.3f} ({times['raw_state'].rank_correlation:.3f})"
            checks[f"true time, {subset.replace('_', ' ')}"] = shown
        splits = f", {name} split" if name in SPLITS else ""
        title = f"Measurement on {z['num_demos']} demonstrations{splits}: z (raw state)"
        return title, rows | checks


def measure_embedding(
    embedding: Embedding,
    demos: Demos,
    *,
    truth: str | Path | Truth | None = None,
    folds: int = 0,
    verbose: bool = True,
) -> Measurement:
    """Measure an embedding on demonstrations.

    Args:
        embedding: the embedding.
        demos: the demonstrations; if it was trained on them, each split is measured separately.
        truth: shortest times, or an .npz with `states` [n, state], `time` [n], and `goals` [n, state] or one
            `goal` [state]; it may have `on_plans` [n]. The columns are those of the demonstrations.
        folds: number of parts into which the demonstrations are divided, to train again without each part and
            measure it (see `planspace.embed.folds`); 0 for none. For few demonstrations.
        verbose: show a progress bar.

    Raises:
        PlanspaceError: the demonstrations lack a state that the embedding reads, numbers are too large to
            compute with, or `truth` or the embedding's own split does not fit.
        UsageError: a state has another unit than the embedding reads, or an argument has another type.
    """
    check_kind("embedding", embedding, Embedding, ": load it first")
    check_kind("demos", demos, Demos, ": load them first")
    used = demos.select(embedding.inputs.names)
    embedding.columns_of(used.info.names, used.info.units)
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
    checks, times = run_checks(embedding, used), None
    if truth is not None:
        times = compare_with_truth(embedding, demos, reference, truth)
        checks = replace(checks, true_time_correlation=times["all"]["z"].rank_correlation)
    measured: dict[str, SplitMeasurement] = {}
    with progress_shown(verbose), progress("measure", len(splits), unit="split") as bar:
        for name, part in splits.items():
            measured[name] = _measure_split(embedding, used, part, reference)
            bar.update()
    if folds:
        with progress_shown(verbose):
            measured["folds"] = _measure_folds(embedding, demos, used, folds)
    quality = examine(used)
    compared = {name: (part.embedding, part.raw_state) for name, part in measured.items()}
    verdict = judge(compared, quality, asdict(checks), embedding.z_dim)
    return Measurement(measured, checks, times, quality, verdict)


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


def run_checks(embedding: Embedding, demos: Demos) -> Checks:
    """Run the checks that apply.

    Args:
        embedding: the embedding.
        demos: demonstrations with the states that the embedding reads.
    """
    z, inputs = embedding.encode(demos.states), embedding.inputs
    quaternions = inputs.quaternions or find_quaternions(demos.info, demos.info.names)
    std, outside = float(np.linalg.norm(z.std(axis=0))), None

    def largest_change(changed: list[np.ndarray]) -> float | None:
        moved = [np.linalg.norm(embedding.encode(states) - z, axis=1).max() for states in changed]
        return float(max(moved) / std) if moved and std > 0 else None

    turns = 2 * np.pi * np.eye(demos.states.shape[1])
    signs = 1.0 - 2.0 * np.array([np.isin(np.arange(len(turns)), q) for q in quaternions])
    if embedding.support is not None:
        outside = float(embedding.outside_support(demos.states).mean())
    return Checks(
        change_by_a_turn=largest_change([demos.states + turns[c] for c in inputs.circular_columns]),
        change_by_a_sign=largest_change([demos.states * sign for sign in signs]),
        outside_support=outside,
    )


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


def _measure_folds(embedding: Embedding, demos: Demos, used: Demos, folds: int) -> SplitMeasurement:
    found, intervals, episodes = measure_folds(embedding.require_about(), demos, folds)
    return SplitMeasurement(
        found, intervals, measure_raw_state(used, episodes, episodes), measure_constant(used, episodes)
    )
