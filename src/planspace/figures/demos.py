"""Demonstrations as a picture: each pair of position and velocity, one line a demonstration."""

import matplotlib.cm
import matplotlib.colors
import matplotlib.figure
import numpy as np

from planspace.demos.dataset import Demos

COLOURMAP = "viridis_r"
MAX_DRAWN = 100
"""More lines than this are a blot; the first ones are drawn."""
MAX_PANELS_A_ROW = 4
VELOCITY_ENDING = "vel"
"""The state `X` is drawn against the state `Xvel`, its velocity."""


def plot_demos(demos: Demos) -> matplotlib.figure.Figure:
    """Draws each position against its velocity, coloured by the time left, ends marked.

    A number of the state that has no partner of its name is drawn against time.
    """
    panels = _panels(demos.info.names)
    columns = min(len(panels), MAX_PANELS_A_ROW)
    rows = -(-len(panels) // columns)
    longest = float(np.max(demos.times[demos.offsets[1:] - 1]))
    figure = matplotlib.figure.Figure(figsize=(5.2 * columns, 4.2 * rows), layout="constrained")
    grid = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, (across, up) in zip(grid, panels, strict=False):
        for i in range(min(len(demos), MAX_DRAWN)):
            episode = demos.episode(i)
            x = episode.times if across is None else episode.states[:, across]
            y = episode.states[:, up]
            left = episode.times[-1] - episode.times
            axes.scatter(x, y, c=left, s=2, cmap=COLOURMAP, vmin=0, vmax=longest)
            axes.plot(x[-1], y[-1], "o", color="crimson", markersize=3)
        axes.set_xlabel("time [s]" if across is None else _label(demos, across))
        axes.set_ylabel(_label(demos, up))
        axes.spines[["top", "right"]].set_visible(False)
    for axes in grid[len(panels) :]:
        axes.remove()
    figure.colorbar(time_left_scale(longest), ax=figure.axes, label="time left [s]")
    return figure


def time_left_scale(longest: float) -> matplotlib.cm.ScalarMappable:
    """The colour scale of the time left [s], from 0 to `longest`."""
    return matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(0, longest), COLOURMAP)


def _panels(names: tuple[str, ...]) -> list[tuple[int | None, int]]:
    """For each panel the column drawn across (None for time) and the one drawn up."""
    place = {name: i for i, name in enumerate(names)}
    velocity_of = {i: place.get(name + VELOCITY_ENDING) for i, name in enumerate(names)}
    paired = set(velocity_of.values())
    return [
        (None, i) if velocity is None else (i, velocity)
        for i, velocity in velocity_of.items()
        if i not in paired
    ]


def _label(demos: Demos, column: int) -> str:
    unit = demos.info.units[column]
    return f"{demos.info.names[column]} [{unit}]" if unit else demos.info.names[column]
