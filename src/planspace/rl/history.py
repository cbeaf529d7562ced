"""The history of a training run: numbers of each iteration and seed. Needs neither JAX nor MuJoCo."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from planspace.errors import PlanspaceError
from planspace.storage.arrays import Arrays, read_arrays
from planspace.storage.checks import reject_malformed

HISTORY = "history.safetensors"
COMMON = ("return", "length", "frozen")
"""Numbers of each iteration and seed that every run has: mean undiscounted return and length of the episodes,
and whether the seed is frozen; see `episode_returns`. An algorithm adds its own numbers."""
EVALUATION = "eval_return"
"""Mean return of deterministic episodes at each of `TrainConfig.evaluations`."""
SUCCESS = "eval_success"
"""Fraction of these episodes that ended at the goal. Gymnasium environments do not have it, nor do runs that
were begun by a version without it."""
LARGEST = 1e100
"""Larger returns are rejected, because their squares overflow."""


def load_history(run: Path, shape: tuple[int, int] | None = None) -> Arrays:
    """Load the history of a finished run.

    Args:
        run: the run's folder.
        shape: the number of iterations and seeds that it must have, if they are known.

    Raises:
        PlanspaceError: the run is not finished, or the history is damaged.
    """
    if not (run / HISTORY).exists():
        raise PlanspaceError(f"{run} is not the folder of a finished training run: it has no {HISTORY}.")
    history = read_arrays(run / HISTORY)
    with reject_malformed(run / HISTORY):
        _check(history, shape or history["return"].shape)
    return history


def frozen_seeds(history: Arrays, seeds: Sequence[int]) -> str:
    """Say which seeds diverged and in which iteration; empty if none did."""
    rows = history["frozen"]
    found = [(seeds[i], int(rows[:, i].argmax()) + 1) for i in np.flatnonzero(rows[-1]).tolist()]
    return ", ".join(f"seed {seed} diverged in iteration {iteration}" for seed, iteration in found)


def with_row(history: Arrays, row: Arrays, number: int) -> Arrays:
    """Copy with one row filled in."""
    updated = dict(history)
    for key, numbers in row.items():
        updated[key] = np.array(history[key])
        updated[key][number] = numbers
    return updated


def finite_or_none(numbers: Sequence[float]) -> list[float | None]:
    """Numbers for JSON: None for a number that is not finite."""
    return [x if np.isfinite(x) else None for x in numbers]


def scalars(row: dict[str, list[float]], seeds: Iterable[int]) -> dict[str, float]:
    """A row of the history as scalars, named so that viewers group them."""
    return {f"{key}/seed {seed}": numbers[i] for key, numbers in row.items() for i, seed in enumerate(seeds)}


def _check(history: Arrays, shape: tuple[int, ...]) -> None:
    """Check that the arrays have this number of iterations and seeds, and values that training can write."""
    iterations, seeds = shape
    evaluations = len(history["eval_steps"])
    wanted = {"steps": (iterations,), "eval_steps": (evaluations,), EVALUATION: (evaluations, seeds)}
    if SUCCESS in history:
        wanted[SUCCESS] = (evaluations, seeds)
    wanted |= dict.fromkeys({*COMMON, *history} - wanted.keys(), shape)
    for name, size in wanted.items():
        array, kind = history[name], "i" if name in ("steps", "eval_steps") else "f"
        if array.shape != size or array.dtype.kind != kind or not math.prod(size):
            raise ValueError(f"{name} has shape {array.shape} and type {array.dtype}")
    returns, frozen = np.abs(history["return"]), history["frozen"]
    if not np.isin(frozen, (0, 1)).all():
        raise ValueError("frozen is neither 0 nor 1")
    lost = ~np.isfinite(returns) & (frozen == 1)  # a return may be the number that froze the seed
    if not ((returns < LARGEST) | lost).all():
        raise ValueError("a return is not finite, or too large")
    if not (np.diff(history["steps"]) > 0).all():
        raise ValueError("its steps do not increase")
