"""K-fold cross-validation: every demonstration is measured by an embedding that was trained on the others."""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from planspace.demos.dataset import Demos
from planspace.embed.about import About
from planspace.embed.config import FitConfig, update_saved
from planspace.embed.geometry import DemoMetrics, Geometry, Interval, bootstrap_intervals, summarise, tabulate
from planspace.embed.objectives import OBJECTIVES
from planspace.errors import PlanspaceError, UsageError
from planspace.progress import progress

PER_EMBEDDING = ("effective_rank", "active_dims")
"""Metrics of the axes of z, which differ between embeddings; they have no intervals."""


def measure_folds(
    about: About, demos: Demos, num_folds: int
) -> tuple[Geometry, Mapping[str, Interval], Int[np.ndarray, " demo"]]:
    """Train again without each part of the demonstrations, and measure that part.

    The selected seed is trained with the same settings, once for each fold. Distances are divided by the root
    mean square distance of the training demonstrations, because each embedding has its own scale.
    `effective_rank` is the mean over the folds, and `active_dims` the least.

    Args:
        about: how the embedding was trained.
        demos: the demonstrations of its training.
        num_folds: number of parts.

    Returns:
        The metrics over all demonstrations, their intervals, and the numbers of the demonstrations.

    Raises:
        UsageError: the number of folds is below 2 or above the number of demonstrations, or the objective is
            the user's own.
        PlanspaceError: the embedding was trained on other demonstrations, or a part of them cannot be used.
    """
    if about.settings.demos != demos.hash:
        raise PlanspaceError(
            "folds train again on the demonstrations of the training, and these are others: give the dataset "
            "that the embedding was trained on."
        )
    if not 2 <= num_folds <= len(demos):
        raise UsageError(
            f"`--folds` must be between 2 and the number of demonstrations, {len(demos)}, got {num_folds}."
        )
    config = _config(about.settings.fit)
    order = np.random.default_rng(about.settings.split_seed).permutation(len(demos))
    folds = [np.sort(part) for part in np.array_split(order, num_folds)]
    tables: list[DemoMetrics] = []
    with progress("measure", num_folds, unit="fold") as bar:
        for fold in folds:
            tables.append(_measure_fold(demos, config, fold, about))
            bar.update()
    whole = DemoMetrics(*(np.concatenate(columns) for columns in zip(*tables, strict=True)))
    parts = [summarise(table) for table in tables]
    found = replace(
        summarise(whole),
        effective_rank=float(np.mean([part.effective_rank for part in parts])),
        active_dims=min(part.active_dims for part in parts),
    )
    intervals = {k: v for k, v in bootstrap_intervals(whole).items() if k not in PER_EMBEDDING}
    return found, intervals, np.arange(len(demos))


def _measure_fold(demos: Demos, config: FitConfig, fold: np.ndarray, about: About) -> DemoMetrics:
    from planspace.embed.fit import fit_seeds

    train = np.setdiff1d(np.arange(len(demos)), fold)
    split = {"train": train, "validation": fold, "test": fold}
    settings: dict[str, Any] = {"seeds": [about.seed], "split_seed": about.settings.split_seed}
    with tempfile.TemporaryDirectory() as folder:
        (embedding,) = fit_seeds(demos, Path(folder), config=config, split=split, **settings)
    scale = np.sqrt(np.mean(tabulate(embedding, demos, train).chord ** 2))
    table = tabulate(embedding, demos, fold)
    return table._replace(chord=table.chord / scale if scale > 0 else table.chord)


def _config(saved: Mapping[str, Any]) -> FitConfig:
    """The settings of a training, from the plain data that an embedding stores."""
    settings = {name: value for name, value in update_saved(saved).items() if name != "time_head"}
    objective = dict(settings.pop("objective"))
    name = objective.pop("name")
    if name not in OBJECTIVES or "source_sha256" in objective:
        raise UsageError(f"folds train again, but the objective {name} is your own code; use a shipped one.")
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()}
    shipped: Any = OBJECTIVES[name]
    return FitConfig(**values, objective=replace(shipped, **objective))
