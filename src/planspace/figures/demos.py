"""Draw demonstrations in state space: one panel per pair of position and velocity."""

import matplotlib.figure
import numpy as np

from planspace.demos.dataset import Demos
from planspace.figures.style import COLOURMAP, END_COLOUR, time_left_scale

MAX_DRAWN = 100
"""Only this many demonstrations are drawn, starting with the first; more would hide each other."""
MAX_PANELS_PER_ROW = 4
VELOCITY_ENDING = "vel"
"""The velocity of the state `X` is the state `Xvel`."""


def plot_demos(demos: Demos) -> matplotlib.figure.Figure:
    """Draw each velocity against its position, coloured by the time left; red points mark the ends.

    A state without a matching velocity is drawn against time.
    """
    panels = _panels(demos.info.names)
    columns = min(len(panels), MAX_PANELS_PER_ROW)
    rows = -(-len(panels) // columns)
    longest = float(np.max(demos.times[demos.offsets[1:] - 1]))
    figure = matplotlib.figure.Figure(figsize=(5.2 * columns, 4.2 * rows), layout="constrained")
    grid = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, (x_column, y_column) in zip(grid, panels, strict=False):
        for i in range(min(len(demos), MAX_DRAWN)):
            episode = demos.episode(i)
            x = episode.times if x_column is None else episode.states[:, x_column]
            y = episode.states[:, y_column]
            left = episode.times[-1] - episode.times
            axes.scatter(x, y, c=left, s=2, cmap=COLOURMAP, vmin=0, vmax=longest)
            axes.plot(x[-1], y[-1], "o", color=END_COLOUR, markersize=3)
        axes.set_xlabel("time [s]" if x_column is None else _label(demos, x_column))
        axes.set_ylabel(_label(demos, y_column))
        axes.spines[["top", "right"]].set_visible(False)
    for axes in grid[len(panels) :]:
        axes.remove()
    figure.colorbar(time_left_scale(longest), ax=figure.axes, label="time left [s]")
    return figure


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
