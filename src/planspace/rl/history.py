"""A run's history: what is recorded of each iteration and seed. Needs neither JAX nor MuJoCo."""

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
LARGEST = 1e100
"""No return is larger; beyond it, it would overflow where its square is taken, or where it is drawn."""


def load_history(run: Path, shape: tuple[int, int] | None = None) -> Arrays:
    """The history of a finished run, as `train` returns it.

    Args:
        run: its folder.
        shape: how many iterations and seeds it must have, where that is known.

    Raises:
        PlanspaceError: there is none, or it is damaged.
    """
    if not (run / HISTORY).exists():
        raise PlanspaceError(f"{run} holds no finished training: it has no {HISTORY}.")
    history = read_arrays(run / HISTORY)
    with reject_malformed(run / HISTORY):
        _check(history, shape or history["return"].shape)
    return history


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


def _check(history: Arrays, shape: tuple[int, ...]) -> None:
    """Sees that it is what `train` writes, of so many iterations and seeds."""
    iterations, seeds = shape
    evaluations = len(history["eval_steps"])
    wanted = {"steps": (iterations,), "eval_steps": (evaluations,), EVALUATION: (evaluations, seeds)}
    wanted |= dict.fromkeys({*COMMON, *history} - wanted.keys(), shape)
    for name, size in wanted.items():
        array, kind = history[name], "i" if name in ("steps", "eval_steps") else "f"
        if array.shape != size or array.dtype.kind != kind or not math.prod(size):
            raise ValueError(f"{name} has shape {array.shape} and type {array.dtype}")
    returns, frozen = np.abs(history["return"]), history["frozen"]
    if not np.isin(frozen, (0, 1)).all():
        raise ValueError("frozen is neither 0 nor 1")
    lost = ~np.isfinite(returns) & (frozen == 1)  # what froze a seed may be a return
    if not ((returns < LARGEST) | lost).all():
        raise ValueError("a return is not finite, or beyond all measure")
    if not (np.diff(history["steps"]) > 0).all():
        raise ValueError("its steps do not rise")
