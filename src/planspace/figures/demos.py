"""Draw demonstrations in state space: one panel per pair of position and velocity."""

from collections.abc import Sequence
from typing import Any

import matplotlib.figure
import numpy as np
from matplotlib.collections import PathCollection

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.figures.style import COLOURMAP, END_COLOUR, MAX_VECTOR, time_left_scale
from planspace.figures.thinning import thin_paths

MAX_DRAWN = 100
"""Only this many demonstrations are drawn, starting with the first; more would hide each other."""
MAX_POINTS, MAX_POINTS_IN_ALL = 20_000, 200_000
"""About this many states are drawn in each panel, and in all panels."""
MAX_PANELS, MAX_PANELS_PER_ROW = 60, 4
VELOCITY_ENDING = "vel"
"""The velocity of the state `X` is the state `Xvel`."""


def plot_demos(demos: Demos) -> matplotlib.figure.Figure:
    """Draw each velocity against its position, coloured by the time left; red points mark the ends.

    A state without a matching velocity is drawn against time. Some states of long demonstrations and the
    panels after the first `MAX_PANELS` are left out; the title says so.
    """
    panels = _panels(demos.info.names)
    shown = panels[:MAX_PANELS]
    columns = min(len(shown), MAX_PANELS_PER_ROW)
    rows = -(-len(shown) // columns)
    longest = float(np.max(demos.times[demos.offsets[1:] - 1]))
    figure = matplotlib.figure.Figure(figsize=(5.2 * columns, 4.2 * rows), layout="constrained")
    grid = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    episodes = [demos.episode(i) for i in range(min(len(demos), MAX_DRAWN))]
    num_points = sum(len(e.states) for e in episodes)
    most = min(MAX_POINTS, MAX_POINTS_IN_ALL // len(shown))
    for axes, (x_column, y_column) in zip(grid, shown, strict=False):
        points = _draw_panel(axes, episodes, (x_column, y_column), longest, most)
        points.set_rasterized(num_points * len(shown) > MAX_VECTOR)
        axes.set_xlabel("time [s]" if x_column is None else _label(demos, x_column))
        axes.set_ylabel(_label(demos, y_column))
        axes.spines[["top", "right"]].set_visible(False)
    for axes in grid[len(shown) :]:
        axes.remove()
    figure.colorbar(time_left_scale(longest), ax=figure.axes, label="time left [s]")
    if left_out := _left_out(demos, len(episodes), min(most, num_points), len(panels)):
        figure.suptitle(left_out, x=0.02, ha="left")
    return figure


def _draw_panel(
    axes: Any, episodes: Sequence[Episode], panel: tuple[int | None, int], longest: float, most: int
) -> PathCollection:
    """Draw all demonstrations as one layer of about `most` points, and their ends."""
    x_column, y_column = panel
    paths = [
        np.column_stack([e.times if x_column is None else e.states[:, x_column], e.states[:, y_column]])
        for e in episodes
    ]
    kept = thin_paths(paths, most)
    x, y = np.concatenate([path[rows] for path, rows in zip(paths, kept, strict=True)]).T
    left = np.concatenate([e.times[-1] - e.times[rows] for e, rows in zip(episodes, kept, strict=True)])
    points = axes.scatter(x, y, c=left, s=2, cmap=COLOURMAP, vmin=0, vmax=longest)
    axes.plot(*np.stack([path[-1] for path in paths]).T, "o", color=END_COLOUR, markersize=3)
    return points


def _left_out(demos: Demos, num_episodes: int, num_points: int, num_panels: int) -> str:
    """What the figure does not show; empty if it shows everything."""
    parts = []
    if num_episodes < len(demos):
        parts.append(f"the first {num_episodes} of {len(demos)} demonstrations")
    if num_points < (num_states := int(demos.offsets[num_episodes])):
        parts.append(f"about {round(num_points, -2):,} of {num_states:,} states in each panel")
    if num_panels > MAX_PANELS:
        parts.append(f"the first {MAX_PANELS} of {num_panels} panels")
    return ", ".join(parts).capitalize()


def _panels(names: tuple[str, ...]) -> list[tuple[int | None, int]]:
    """The columns on the x axis (None for time) and on the y axis of each panel."""
    column = {name: i for i, name in enumerate(names)}
    velocity_of = {i: column.get(name + VELOCITY_ENDING) for i, name in enumerate(names)}
    paired = set(velocity_of.values())
    return [
        (None, i) if velocity is None else (i, velocity)
        for i, velocity in velocity_of.items()
        if i not in paired
    ]


def _label(demos: Demos, column: int) -> str:
    unit = demos.info.units[column]
    return f"{demos.info.names[column]} [{unit}]" if unit else demos.info.names[column]
