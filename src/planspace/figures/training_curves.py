"""Draw the training of an embedding, one line per seed, as in the paper's figure."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib.figure
import matplotlib.ticker
import numpy as np
from jaxtyping import Float

from planspace.embed.training_log import LogRow
from planspace.errors import PlanspaceError
from planspace.figures.style import COLOURS

WINDOW_FRACTION, MIN_WINDOW = 0.05, 3
"""Length of the rolling mean: a fraction of the rows in the log, and at least this many rows."""
CURVES = (
    ("path_error", "path error on the training demonstrations", "path error"),
    ("bound", "objective (maximised)", "bound per triplet [nats]"),
)
"""For each panel: a key of `LogRow`, the title, and the label of the y axis."""
EARLY_FRACTION, MAX_STRETCH = 0.1, 3.0
"""If the first 10 % of the training would stretch the y axis to more than about 3 times what the rest needs,
they are clipped."""
Values = Float[np.ndarray, "row seed"]


class Rolling(NamedTuple):
    """Statistics of the rows around each row."""

    mean: Values
    low: Values
    """Minimum."""
    high: Values
    """Maximum."""


def plot_training(
    log: Sequence[LogRow],
    selected: int | None = None,
    seeds: Sequence[int] | None = None,
    title: str = "Training, one line per seed",
) -> matplotlib.figure.Figure:
    """Draw path error and objective against optimiser steps.

    Lines are rolling means. Bands show the minimum and maximum over the same rows.

    Args:
        log: the rows of the log, see `read_log`.
        selected: the position of the selected seed, which is drawn thicker.
        seeds: the seeds, for the legend; by default 0, 1, 2, ...
        title: the title of the figure.

    Raises:
        PlanspaceError: the log has no rows with a path error and a bound.
    """
    figure = matplotlib.figure.Figure(figsize=(10, 4.4), layout="constrained")
    for axes, (name, what, label) in zip(figure.subplots(1, 2), CURVES, strict=True):
        rows = [row for row in log if name in row]
        if not rows:
            raise PlanspaceError(f"the log has no row with {name!r}, so there is nothing to draw.")
        steps = np.array([row["step"] for row in rows])
        _draw_seeds(axes, steps, np.array([row[name] for row in rows], dtype=float), selected, seeds)
        axes.set_title(what, loc="left")
        axes.set_ylabel(label)
        axes.set_xlabel("optimiser steps")
        axes.xaxis.set_major_formatter(matplotlib.ticker.StrMethodFormatter("{x:,.0f}"))
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False)
    what = f"rolling mean and range over {_window(len(log))} log rows"
    figure.suptitle(f"{title} ({what})", x=0.02, ha="left")
    return figure


def _draw_seeds(
    axes: Any, steps: np.ndarray, values: Values, selected: int | None, seeds: Sequence[int] | None
) -> None:
    smooth = rolling(values, _window(len(values)))
    marker = "o" if len(values) == 1 else None  # a line through one point is invisible
    for i in range(values.shape[1]):
        colour = COLOURS[i % len(COLOURS)]
        label = f"seed {i if seeds is None else seeds[i]}" + (", selected" if i == selected else "")
        width, order = (3.0, 3) if i == selected else (1.3, 2)
        axes.fill_between(steps, smooth.low[:, i], smooth.high[:, i], color=colour, alpha=0.18, linewidth=0)
        axes.plot(
            steps, smooth.mean[:, i], color=colour, linewidth=width, zorder=order, label=label, marker=marker
        )
    _clip_start(axes, smooth)


def rolling(values: Values, window: int) -> Rolling:
    """Mean, minimum and maximum over `window` rows around each row; fewer at both ends."""
    before, after = (window - 1) // 2, window // 2
    parts = [values[max(i - before, 0) : i + after + 1] for i in range(len(values))]
    return Rolling(
        np.stack([p.mean(axis=0) for p in parts]),
        np.stack([p.min(axis=0) for p in parts]),
        np.stack([p.max(axis=0) for p in parts]),
    )


def _window(num_rows: int) -> int:
    """Length of the rolling mean; odd, so that each row is in the middle of its window."""
    return max(MIN_WINDOW, round(WINDOW_FRACTION * num_rows)) // 2 * 2 + 1


def _clip_start(axes: Any, smooth: Rolling) -> None:
    top = float(smooth.high.max())
    later = float(smooth.mean[int(EARLY_FRACTION * len(smooth.mean)) :].min())
    bottom = top - MAX_STRETCH * (top - later)
    if smooth.low.min() < bottom < top:
        axes.set_ylim(bottom, top + 0.05 * (top - bottom))
