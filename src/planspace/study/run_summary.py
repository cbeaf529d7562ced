"""The summary of a `planspace run`: declared types, and `summary.json`."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos
from planspace.embed.about import About
from planspace.storage.arrays import Arrays
from planspace.study.results import Metrics
from planspace.study.run_control import ControlResults

NEAR_GOAL = 0.5
"""Demonstrations that end within this L1 distance of the goal count as near it."""
FINAL_ITERATIONS = 10
"""Each seed's return is averaged over this many last iterations."""
GEOMETRY_ROWS = (
    ("straightness", "straightness", "1 is a straight line"),
    ("speed_variation", "speed variation", "0 is constant speed"),
    ("midpoint_error", "midpoint error", "0 is even spacing on a line"),
    ("time_correlation", "time correlation", "1: distance to the end orders the time left"),
    ("effective_rank", "effective rank", "dimensions in use"),
    ("decoded_error", "decoded error", "of the state decoded from z, in standard deviations"),
)
"""Key, name and explanation of each geometry metric that is shown."""


@dataclass(frozen=True)
class DemosSummary:
    """The planned demonstrations."""

    count: int
    """Number of demonstrations."""
    at_goal: int
    """Number of demonstrations that end within the problem's tolerance of their goal."""
    fraction_near_goal: float
    """Fraction of demonstrations that end within `near_goal` of the goal."""
    near_goal: float
    """L1 distance."""
    median_end_distance: float
    """Median L1 distance between the last state and the goal."""
    median_duration_s: float

    @classmethod
    def of(cls, demos: Demos) -> "DemosSummary":
        """Summarise a dataset."""
        _, space = demos.info.compile()
        distances = space.distance(demos.states[demos.offsets[1:] - 1], demos.goals)
        return cls(
            count=len(demos),
            at_goal=int(demos.success.sum()),
            fraction_near_goal=float(np.mean(distances <= NEAR_GOAL)),
            near_goal=NEAR_GOAL,
            median_end_distance=float(np.median(distances)),
            median_duration_s=float(np.median(demos.times[demos.offsets[1:] - 1])),
        )


@dataclass(frozen=True)
class GeometrySummary:
    """Geometry metrics on test demonstrations."""

    embedding_seed: int
    """The selected seed."""
    embedding: Metrics
    """Metrics of the embedding."""
    raw_state: Metrics
    """The same metrics of the standardised raw state."""

    @classmethod
    def of(cls, about: About) -> "GeometrySummary":
        """Take the metrics on the test split from an embedding's description."""
        return cls(about.seed, _without_nan(about.metrics["test"]), _without_nan(about.metrics_raw_state))


@dataclass(frozen=True)
class ArmReturns:
    """The final returns of an arm's seeds."""

    steps: int
    """Environment steps per seed."""
    seeds: int
    """Number of seeds."""
    mean: float
    worst: float
    best: float
    standard_deviation: float
    """Over seeds; 0 for a single seed."""

    @classmethod
    def of(cls, history: Arrays) -> "ArmReturns":
        """Summarise a training history."""
        final = history["return"][-FINAL_ITERATIONS:].mean(axis=0)
        return cls(
            steps=int(history["steps"][-1]),
            seeds=len(final),
            mean=float(final.mean()),
            worst=float(final.min()),
            best=float(final.max()),
            standard_deviation=float(final.std(ddof=1)) if len(final) > 1 else 0.0,
        )


@dataclass(frozen=True)
class RunSummary:
    """The results of a `planspace run`."""

    control: ControlResults
    """Success of control by distance in z, by raw distance and by reward."""
    task: str
    budget: str
    seed: int
    version: str
    """Version of planspace."""
    demos: DemosSummary
    geometry: GeometrySummary
    arms: Mapping[str, ArmReturns]
    """Final returns by the arm's label; empty without `--train`."""
    diverged: tuple[str, ...]
    """One text per arm with seeds that diverged."""
    verdicts: tuple[str, ...] = ()
    """Whether the seeds separate the arms, one sentence per pair."""
    unsolved: str = ""
    """The message about demonstrations that were not found; empty if all were."""


def as_json(summary: RunSummary) -> dict[str, Any]:
    """The content of `summary.json`. Scripts read its keys: they may not change."""
    demos, geometry = summary.demos, summary.geometry
    return {
        "control": _control_json(summary.control),
        "task": summary.task,
        "budget": summary.budget,
        "seed": summary.seed,
        "version": summary.version,
        "demos": {
            "count": demos.count,
            "at_goal": demos.at_goal,
            "share_near_goal": demos.fraction_near_goal,
            "near_goal": demos.near_goal,
            "median_end_distance": demos.median_end_distance,
            "median_duration_s": demos.median_duration_s,
        },
        "geometry": {
            "split": "test",
            "embedding_seed": geometry.embedding_seed,
            "embedding": dict(geometry.embedding),
            "raw_state": dict(geometry.raw_state),
        },
        "arms": {label: _arm_json(arm) for label, arm in summary.arms.items()},
        "diverged": list(summary.diverged),
        "verdicts": list(summary.verdicts),
    }


def _control_json(control: ControlResults) -> dict[str, Any]:
    """The comparison of z with raw distance; null where control was left out."""
    found = control.reached
    return {
        "success": None if found is None else {**asdict(found), "interval": list(found.interval)},
        "by_horizon": {
            "horizons_s": list(control.horizons),
            "starts": control.horizon_starts,
            "successes": {cost: list(counts) for cost, counts in control.by_horizon},
        },
        "notes": list(control.notes),
    }


def _arm_json(arm: ArmReturns) -> dict[str, int | float]:
    return {
        "steps": arm.steps,
        "seeds": arm.seeds,
        "mean": arm.mean,
        "worst": arm.worst,
        "best": arm.best,
        "deviation": arm.standard_deviation,
    }


def _without_nan(metrics: Metrics) -> Metrics:
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in metrics.items()}
