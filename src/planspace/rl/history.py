"""A run's history: what is recorded of each iteration and seed. Needs neither JAX nor MuJoCo."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from planspace.errors import PlanspaceError
from planspace.store import Arrays, read_arrays

HISTORY = "history.safetensors"
HISTORY_KEYS = (
    "return",
    "length",
    "kl",
    "entropy",
    "loss",
    "improvement",
    "explained_variance",
    "skipped",
    "frozen",
)
"""What is recorded for each iteration and seed; see `episode_returns`, `UpdateInfo` and `Learner`."""
EVALUATION = "eval_return"
"""Mean return of deterministic episodes, apart from training, at each of `TrainConfig.evaluations`."""


def load_history(run: Path) -> Arrays:
    """The history of a finished run, as `train` returns it.

    Raises:
        PlanspaceError: there is none, or it is damaged.
    """
    if not (run / HISTORY).exists():
        raise PlanspaceError(f"{run} holds no finished training: it has no {HISTORY}.")
    return read_arrays(run / HISTORY)


def frozen_seeds(history: Arrays, seeds: Sequence[int]) -> str:
    """Names the seeds that diverged and the iteration at which each did; empty if none."""
    rows = history["frozen"]
    found = [(seeds[i], int(rows[:, i].argmax()) + 1) for i in np.flatnonzero(rows[-1]).tolist()]
    return ", ".join(f"seed {seed} diverged in iteration {iteration}" for seed, iteration in found)


def with_row(history: Arrays, row: Arrays, number: int) -> Arrays:
    """A copy with one row filled in."""
    updated = dict(history)
    for key, numbers in row.items():
        updated[key] = np.array(history[key])
        updated[key][number] = numbers
    return updated


def without_nan(row: dict[str, list[float]]) -> dict[str, list[float | None]]:
    """As JSON can hold it."""
    return {key: [x if np.isfinite(x) else None for x in numbers] for key, numbers in row.items()}


def scalars(row: dict[str, list[float]], seeds: Iterable[int]) -> dict[str, float]:
    """A row of the history by names that group in a viewer."""
    return {f"{key}/seed {seed}": numbers[i] for key, numbers in row.items() for i, seed in enumerate(seeds)}
