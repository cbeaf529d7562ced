"""Demonstrations as a picture: each pair of position and velocity, one line a demonstration."""

import matplotlib.cm
import matplotlib.colors
import matplotlib.figure
import numpy as np

from planspace.demos.dataset import Demos

COLOURMAP = "viridis_r"
MAX_DRAWN = 100
"""More lines than this are a blot; the first ones are drawn."""


def plot_demos(demos: Demos) -> matplotlib.figure.Figure:
    """Draws position against velocity for each joint, coloured by the time left, ends marked."""
    n = len(demos.info.names) // 2
    longest = float(np.max(demos.times[demos.offsets[1:] - 1]))
    figure = matplotlib.figure.Figure(figsize=(5.2 * n, 4.2), layout="constrained")
    for joint, axes in enumerate(np.atleast_1d(figure.subplots(1, n))):
        for i in range(min(len(demos), MAX_DRAWN)):
            episode = demos.episode(i)
            x, v = episode.states[:, joint], episode.states[:, n + joint]
            left = episode.times[-1] - episode.times
            axes.scatter(x, v, c=left, s=2, cmap=COLOURMAP, vmin=0, vmax=longest)
            axes.plot(x[-1], v[-1], "o", color="crimson", markersize=3)
        axes.set_xlabel(_label(demos, joint))
        axes.set_ylabel(_label(demos, n + joint))
        axes.spines[["top", "right"]].set_visible(False)
    figure.colorbar(time_left_scale(longest), ax=figure.axes, label="time left [s]")
    return figure


def time_left_scale(longest: float) -> matplotlib.cm.ScalarMappable:
    """The colour scale of the time left [s], from 0 to `longest`."""
    return matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(0, longest), COLOURMAP)


def _label(demos: Demos, column: int) -> str:
    unit = demos.info.units[column]
    return f"{demos.info.names[column]} [{unit}]" if unit else demos.info.names[column]
