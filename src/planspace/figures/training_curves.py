"""The curves of an embedding's training: reading its log, and the paper's figure of it."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.figure
import matplotlib.ticker
import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import LOG
from planspace.errors import PlanspaceError
from planspace.figures.style import COLOURS
from planspace.storage.files import read_bytes

WINDOW_SHARE, MIN_WINDOW = 0.05, 3
"""Rows of the log in the rolling mean: a share of all, and at least so many."""
CURVES = (
    ("path_error", "path error on the training demonstrations", "path error"),
    ("bound", "what is maximised", "bound per triplet [nats]"),
)
"""Fields of a log's row, the panel's title and its axis."""
EARLY_SHARE, EARLY_STRETCH = 0.1, 3.0
"""A curve's early part is cut off where it would squeeze the rest to less than about a third of the axis."""


def read_log(folder: Path) -> list[dict[str, Any]]:
    """Reads the curves of a training, in order of steps.

    Of a step that is there twice the later row counts; a last line cut off by a crash is passed over.

    Args:
        folder: an embedding's folder, which holds log.jsonl.

    Raises:
        PlanspaceError: there is no log, or a line before the last is damaged.
    """
    path = folder / LOG
    lines = read_bytes(path).decode(errors="replace").splitlines()
    rows: dict[int, dict[str, Any]] = {}
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
            rows[int(row["step"])] = row
        except (ValueError, KeyError, TypeError) as error:
            if number == len(lines):
                break
            raise PlanspaceError(
                f"{path}, line {number} is damaged ({error}); `planspace repair {folder}` leaves it out."
            ) from error
    return [rows[step] for step in sorted(rows)]


def plot_training(
    log: Sequence[Mapping[str, Any]],
    kept: int | None = None,
    seeds: Sequence[int] | None = None,
    title: str = "Training, seed by seed",
) -> matplotlib.figure.Figure:
    """Draws the curves of a training, one a seed, as the paper's figure of it does.

    Lines are rolling means, bands the range of what they are means of.

    Args:
        log: rows as `read_log` gives them: a step, and for each curve a number a seed.
        kept: which seed was kept, counted from 0; it is drawn thicker.
        seeds: the seeds themselves, to name them by; by default they are counted.
        title: what it is of.

    Raises:
        PlanspaceError: the log has no rows with a path error and a bound.
    """
    figure = matplotlib.figure.Figure(figsize=(10, 4.4), layout="constrained")
    for axes, (name, what, label) in zip(figure.subplots(1, 2), CURVES, strict=True):
        rows = [row for row in log if name in row]
        if not rows:
            raise PlanspaceError(f"the log has no row with {name!r}; there is nothing to draw.")
        steps = np.array([row["step"] for row in rows])
        values = np.array([row[name] for row in rows], dtype=float)
        mean, low, high = rolling(values, _window(len(rows)))
        marker = "o" if len(rows) == 1 else None  # a line through one point would not be seen
        for i in range(values.shape[1]):
            colour = COLOURS[i % len(COLOURS)]
            seed = f"seed {i if seeds is None else seeds[i]}" + (", kept" if i == kept else "")
            width, order = (3.0, 3) if i == kept else (1.3, 2)
            axes.fill_between(steps, low[:, i], high[:, i], color=colour, alpha=0.18, linewidth=0)
            axes.plot(
                steps, mean[:, i], color=colour, linewidth=width, zorder=order, label=seed, marker=marker
            )
        _cut_early(axes, mean, low, high)
        axes.set_title(what, loc="left")
        axes.set_ylabel(label)
        axes.set_xlabel("optimiser steps")
        axes.xaxis.set_major_formatter(matplotlib.ticker.StrMethodFormatter("{x:,.0f}"))
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False)
    figure.suptitle(
        f"{title}: rolling mean of {_window(len(log))} rows of the log, and their range",
        x=0.02,
        ha="left",
    )
    return figure


def rolling(
    values: Float[np.ndarray, "row seed"], window: int
) -> tuple[Float[np.ndarray, "row seed"], Float[np.ndarray, "row seed"], Float[np.ndarray, "row seed"]]:
    """Mean, least and greatest over the rows around each, fewer at either end."""
    before, after = (window - 1) // 2, window // 2
    parts = [values[max(i - before, 0) : i + after + 1] for i in range(len(values))]
    return (
        np.stack([p.mean(axis=0) for p in parts]),
        np.stack([p.min(axis=0) for p in parts]),
        np.stack([p.max(axis=0) for p in parts]),
    )


def _window(num_rows: int) -> int:
    """An odd number of rows, so that each stands in the middle of its window."""
    return max(MIN_WINDOW, round(WINDOW_SHARE * num_rows)) // 2 * 2 + 1


def _cut_early(axes: Any, mean: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    top = float(high.max())
    later = float(mean[int(EARLY_SHARE * len(mean)) :].min())
    bottom = top - EARLY_STRETCH * (top - later)
    if low.min() < bottom < top:
        axes.set_ylim(bottom, top + 0.05 * (top - bottom))
