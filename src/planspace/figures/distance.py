"""Draw the distance to the end of demonstrations against the time left."""

from collections.abc import Sequence
from typing import Any

import matplotlib.cm
import matplotlib.colors
import matplotlib.figure
import numpy as np
from jaxtyping import Float
from matplotlib.collections import LineCollection

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.figures.style import COLOURMAP, MAX_VECTOR
from planspace.figures.thinning import thin_paths

MAX_DRAWN = 100
"""Only this many demonstrations are drawn, starting with the first; more would hide each other."""
MAX_POINTS = 100_000
"""About this many points are drawn on each side."""
DIAGONAL_COLOUR = "black"
Path = Float[np.ndarray, "_time _axis"]


def plot_distance_against_time(
    embedding: Embedding, demos: Demos, episodes: np.ndarray
) -> matplotlib.figure.Figure:
    """Draw the distance from each state to the end of its demonstration, in z and in state space.

    The state is standardised with the standard deviation over all `demos`.

    Args:
        embedding: the embedding.
        demos: the demonstrations.
        episodes: the numbers of the demonstrations to draw.

    Raises:
        PlanspaceError: the demonstrations lack a state that the embedding reads.
    """
    demos = demos.select(embedding.inputs.names)
    parts = [demos.episode(int(i)) for i in episodes]
    std = demos.states.std(axis=0)
    std = np.where(std > 0, std, 1.0)
    return plot_distances(
        [embedding.encode(e.states) for e in parts], [e.states / std for e in parts], [e.times for e in parts]
    )


def plot_distances(
    z: Sequence[Path], states: Sequence[Path], times: Sequence[Float[np.ndarray, " _time"]]
) -> matplotlib.figure.Figure:
    """Draw the distance to the end of each path against the time left, in z and in state space.

    Distances are divided by the mean distance from start to end, times by the mean duration. Straight lines
    with the same constant speed therefore lie on the diagonal. All paths count in these means; the first
    `MAX_DRAWN` are drawn.

    Args:
        z: the demonstrations in z.
        states: the demonstrations in standardised states.
        times: the times of each demonstration [s].
    """
    durations = np.array([t[-1] for t in times])
    figure = matplotlib.figure.Figure(figsize=(10, 5), layout="constrained")
    left_axes, right_axes = figure.subplots(1, 2, sharex=True, sharey=True)
    norm = matplotlib.colors.Normalize(durations.min(), durations.max())
    for axes, title, paths in (
        (left_axes, "plan space", z),
        (right_axes, "standardised state", states),
    ):
        curves = _curves(paths, times)[:MAX_DRAWN]
        num_points = sum(map(len, curves))
        kept = thin_paths(curves, MAX_POINTS)
        curves = [curve[rows] for curve, rows in zip(curves, kept, strict=True)]
        lines = LineCollection(curves, cmap=COLOURMAP, norm=norm, linewidths=0.8, alpha=0.7)
        lines.set_array(durations[:MAX_DRAWN])
        lines.set_rasterized(num_points > MAX_VECTOR)
        axes.add_collection(lines)
        _draw_diagonal(axes, float(durations.max() / durations.mean()))
        axes.set_title(title, loc="left")
        axes.set_ylabel("distance to the end / mean distance at the start")
        axes.set_xlabel(f"time left / mean duration ({durations.mean():.3g} s)")
        axes.spines[["top", "right"]].set_visible(False)
    left_axes.set(xlim=(0, None), ylim=(0, None))
    what = f"{len(times)} demonstrations"
    if len(times) > MAX_DRAWN:
        what = f"the first {MAX_DRAWN} of {what}"
    figure.suptitle(f"Distance to the end against time left, {what}", x=0.02, ha="left")
    mappable = matplotlib.cm.ScalarMappable(norm, COLOURMAP)
    figure.colorbar(mappable, ax=[left_axes, right_axes], label="duration of the demonstration [s]")
    figure.legend(handles=left_axes.get_legend_handles_labels()[0], loc="outside lower left", frameon=False)
    return figure


def _curves(paths: Sequence[Path], times: Sequence[np.ndarray]) -> list[Float[np.ndarray, "_time 2"]]:
    """Time left and distance to the end of each path, both relative to their means."""
    distances = [np.linalg.norm(p - p[-1], axis=1) for p in paths]
    mean_distance = np.mean([d[0] for d in distances]) or 1.0
    mean_duration = np.mean([t[-1] for t in times])
    return [
        np.column_stack([(t[-1] - t) / mean_duration, d / mean_distance])
        for t, d in zip(times, distances, strict=True)
    ]


def _draw_diagonal(axes: Any, longest: float) -> None:
    axes.plot(
        [0, longest],
        [0, longest],
        color=DIAGONAL_COLOUR,
        linestyle="--",
        linewidth=1.4,
        label="straight lines with the same constant speed",
    )
