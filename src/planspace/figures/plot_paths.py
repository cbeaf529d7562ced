"""Draw demonstrations as paths in z with Matplotlib."""

from typing import Any

import matplotlib.figure
import matplotlib.ticker
import numpy as np
from matplotlib.collections import LineCollection
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from planspace.figures.paths import Paths
from planspace.figures.style import COLOURMAP, END_COLOUR, MAX_VECTOR, time_left_scale

MIN_SIDE = 0.25
"""Shortest side of a 3-D box as a fraction of its longest side."""


def plot_paths(paths: Paths) -> matplotlib.figure.Figure:
    """Draw paths in z, coloured by the time left; red points mark the ends."""
    figure = matplotlib.figure.Figure(figsize=(7.6, 5.6), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d" if paths.is_3d else None)
    segments = np.concatenate([np.stack([p[:-1], p[1:]], axis=1) for p in paths.points])
    left = np.concatenate([paths.time_left(i)[:-1] for i in range(len(paths.points))])
    scale = time_left_scale(paths.longest)
    collection = Line3DCollection if paths.is_3d else LineCollection
    lines = collection(list(segments), cmap=COLOURMAP, norm=scale.norm, linewidths=1.2, alpha=0.9)
    lines.set_array(left)
    lines.set_rasterized(paths.num_states > MAX_VECTOR)
    axes.add_collection(lines)
    ends = np.stack([p[-1] for p in paths.points])
    (mark,) = axes.plot(*ends.T, "o", color=END_COLOUR, markersize=4, label="end of a demonstration")
    for name, label in zip("xyz", paths.labels, strict=False):
        axes.set(**{f"{name}label": label})
    if paths.is_3d:
        _frame_3d(axes, np.concatenate(paths.points))
    else:
        _frame_2d(axes, equal=not paths.against_time)
    figure.suptitle(paths.title, x=0.02, ha="left")
    figure.legend(handles=[mark], loc="outside lower left", frameon=False)
    figure.colorbar(scale, ax=axes, label="time left [s]", shrink=0.75, pad=0.12 if paths.is_3d else 0.02)
    return figure


def _frame_2d(axes: Any, *, equal: bool) -> None:
    axes.margins(0.04)
    axes.spines[["top", "right"]].set_visible(False)
    if equal:  # a distance in z looks the same in every direction
        axes.set_aspect("equal", adjustable="datalim")


def _frame_3d(axes: Any, points: np.ndarray) -> None:
    """Set the limits so that a distance in z looks the same in every direction."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, MIN_SIDE * (np.max(high - low) or 1.0)) * 1.04
    middle = (low + high) / 2
    for name, centre, length in zip("xyz", middle, span, strict=True):
        axes.set(**{f"{name}lim": (centre - length / 2, centre + length / 2)})
    axes.set_proj_type("ortho")
    axes.set_box_aspect(span, zoom=1.1)
    for axis, length in zip((axes.xaxis, axes.yaxis, axes.zaxis), span / span.max(), strict=True):
        axis.set_pane_color("white")
        axis.set_major_locator(matplotlib.ticker.MaxNLocator(max(2, round(6 * length))))
        axis._axinfo["grid"].update(color="0.88", linewidth=0.6)
        axis.labelpad = 8
