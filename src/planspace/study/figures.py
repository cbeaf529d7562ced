"""The figures of a study: matplotlib for image files, Plotly for the interactive report."""

import itertools
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import matplotlib.figure
import numpy as np
import plotly.graph_objects as go

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.figures.learning_curves import MAX_BANDS, STYLES
from planspace.figures.projection import principal_components
from planspace.figures.style import COLOURMAP, COLOURS, time_left_scale
from planspace.rl.learning_curve import Curve
from planspace.study.results import Paths, SeedRow
from planspace.study.tables import ArmRow

Profile = tuple[np.ndarray, np.ndarray]
"""Returns, and the fraction of seeds above each."""
DASHES = ("solid", "dash", "dot")
NO_BANDS: Mapping[str, Curve] = MappingProxyType({})
FREE_NAMES, LEGEND_LINE = 4, 16
"""A legend has room for this many names; for each further one, the figure is this many pixels higher."""
MAX_PATHS = 20
"""Number of demonstrations that `plot_paths` draws. More would hide each other."""


def interactive_curves(
    curves: Mapping[str, Curve],
    bands: Mapping[str, Curve] = NO_BANDS,
    solved: float | None = None,
) -> go.Figure:
    """Learning curves by the arm's label. Bands are left out if there are more than `MAX_BANDS` arms.

    Args:
        curves: the curves.
        bands: curves of other seeds, by the same labels; their bands replace those of `curves`.
        solved: the return from which on the task is solved, drawn as a line; None draws no line.
    """
    figure = go.Figure()
    if len(curves) > MAX_BANDS:
        return _interactive_means(curves)
    for colour, (label, c) in zip(itertools.cycle(COLOURS), curves.items(), strict=False):
        _add_band(figure, label, bands.get(label, c), colour)
        figure.add_scatter(
            x=c.steps,
            y=c.mean,
            name=label,
            legendgroup=label,
            mode="lines",
            line={"color": colour, "width": 3},
        )
        if bands:
            continue
        figure.add_scatter(
            x=c.steps,
            y=c.best,
            name=f"{label}, best seed",
            legendgroup=label,
            showlegend=False,
            mode="lines",
            line={"color": colour, "width": 1, "dash": "dash"},
        )
    if solved is not None:
        figure.add_hline(y=solved, line={"color": "#888", "dash": "dot"}, annotation_text="solved")
    titles = {"xaxis_title": "environment steps per seed", "yaxis_title": "episode return"}
    figure.update_layout(**titles, **_flat_layout(len(curves)))
    return figure


def _add_band(figure: go.Figure, label: str, c: Curve, colour: str) -> None:
    band = {"mode": "lines", "line_width": 0, "hoverinfo": "skip", "legendgroup": label}
    figure.add_scatter(x=c.steps, y=c.high, showlegend=False, **band)
    figure.add_scatter(x=c.steps, y=c.low, fill="tonexty", fillcolor=_faint(colour), showlegend=False, **band)


def _interactive_means(curves: Mapping[str, Curve]) -> go.Figure:
    figure = go.Figure()
    for i, (label, c) in enumerate(curves.items()):
        line = {
            "color": COLOURS[i % len(COLOURS)],
            "width": 3,
            "dash": DASHES[i // len(COLOURS) % len(DASHES)],
        }
        figure.add_scatter(x=c.steps, y=c.mean, name=label, mode="lines", line=line)
    titles = {"xaxis_title": "environment steps per seed", "yaxis_title": "episode return"}
    figure.update_layout(**titles, **_flat_layout(len(curves)))
    return figure


def plot_profiles(profiles: Mapping[str, Profile], title: str) -> matplotlib.figure.Figure:
    """Performance profiles of several arms: the fraction of seeds above each return."""
    figure = matplotlib.figure.Figure(figsize=(9.5, 4.3), layout="constrained")
    axes = figure.subplots()
    for i, (label, (returns, fractions)) in enumerate(profiles.items()):
        cycle, colour = divmod(i, len(COLOURS))
        style = STYLES[cycle % len(STYLES)]
        axes.plot(
            returns, fractions, drawstyle="steps-post", color=COLOURS[colour], linestyle=style, label=label
        )
    axes.set_xlabel("final return")
    axes.set_ylabel("fraction of seeds above it")
    axes.set_ylim(-0.02, 1.02)
    axes.set_title(title, loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(frameon=False, fontsize="small", loc="outside right upper")
    return figure


def plot_reached(
    reached: Mapping[str, np.ndarray], rows: Sequence[ArmRow], title: str
) -> matplotlib.figure.Figure:
    """Final returns of each arm's seeds, with their mean and its interval.

    Args:
        reached: final return of each seed, by the arm's label.
        rows: the arms' rows of the table, in the same order.
        title: title of the figure.
    """
    figure = matplotlib.figure.Figure(figsize=(8, 1.6 + 0.36 * len(reached)), layout="constrained")
    axes = figure.subplots()
    for i, (x, row) in enumerate(zip(reached.values(), rows, strict=True)):
        colour, (low, high) = COLOURS[i % len(COLOURS)], row.mean_interval
        spread = np.linspace(-0.22, 0.22, len(x)) if len(x) > 1 else np.zeros(1)
        axes.plot(x, i + spread, ".", color=colour, alpha=0.4, markersize=4)
        axes.plot([low, high], [i, i], color=colour, linewidth=2.5)
        axes.plot(row.mean, i, "D", color=colour, markersize=6, markeredgecolor="white")
    axes.set_yticks(range(len(reached)), labels=list(reached))
    axes.invert_yaxis()
    axes.set_xlabel("final return: seeds, mean, 95 % interval of the mean")
    axes.set_title(title, loc="left")
    axes.grid(axis="x", color="0.9")
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    return figure


def interactive_profiles(profiles: Mapping[str, Profile]) -> go.Figure:
    """Performance profiles of several arms, as in `plot_profiles`."""
    figure = go.Figure()
    for i, (label, (returns, fractions)) in enumerate(profiles.items()):
        cycle, colour = divmod(i, len(COLOURS))
        line = {"color": COLOURS[colour], "width": 2, "shape": "hv", "dash": DASHES[cycle % len(DASHES)]}
        figure.add_scatter(x=returns, y=fractions, name=label, mode="lines", line=line)
    titles = {"xaxis_title": "final return"}
    figure.update_layout(yaxis_title="fraction of seeds above it", **titles, **_flat_layout(len(profiles)))
    return figure


def interactive_training(steps: Sequence[int], curves: Sequence[SeedRow], name: str) -> go.Figure:
    """A quantity during the training of an embedding, with one line per seed; `curves` is [row][seed]."""
    figure = go.Figure()
    for i, values in enumerate(zip(*curves, strict=True)):
        line = {"color": COLOURS[i % len(COLOURS)], "width": 2}
        figure.add_scatter(x=list(steps), y=list(values), name=f"seed {i}", mode="lines", line=line)
    figure.update_layout(xaxis_title="optimiser steps", yaxis_title=name, **_flat_layout(1))
    return figure


def interactive_lines(paths: Paths) -> go.Figure:
    """Demonstrations in z, in 3-D."""
    figure = go.Figure()
    for path in paths:
        columns = np.array(path).T
        x, y, z = (*columns, *np.zeros((3 - len(columns), columns.shape[1])))
        left = np.linspace(1.0, 0.0, len(x))
        line = {"color": left, "colorscale": COLOURMAP, "width": 5}
        figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line=line, showlegend=False, hoverinfo="skip")
        end = {"color": "crimson", "size": 4}
        figure.add_scatter3d(
            x=x[-1:], y=y[-1:], z=z[-1:], mode="markers", marker=end, showlegend=False, hoverinfo="skip"
        )
    axis = {"showbackground": False, "gridcolor": "#888", "zerolinecolor": "#888"}
    axes = {f"{name}axis": {**axis, "title": f"component {i + 1}"} for i, name in enumerate("xyz")}
    figure.update_layout(scene={**axes, "aspectmode": "data"}, **plain_layout())
    return figure


def plot_spaces(spaces: Mapping[str, Paths]) -> matplotlib.figure.Figure:
    """Demonstrations in several embeddings, on two principal components of z."""
    columns = min(len(spaces), 3)
    rows = -(-len(spaces) // columns)
    figure = matplotlib.figure.Figure(figsize=(4 * columns, 0.6 + 3.6 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for axes, (name, paths) in itertools.zip_longest(panels, spaces.items(), fillvalue=(None, ())):
        axes.spines[["top", "right"]].set_visible(False)
        if name is None:
            axes.set_axis_off()
            continue
        axes.set_title(name, fontsize="small", loc="left", wrap=True)
        for path in paths:
            x, y = (*np.array(path).T, np.zeros(len(path)))[:2]
            axes.plot(x, y, color="0.85", linewidth=0.6, zorder=1)
            axes.scatter(x, y, c=np.linspace(1.0, 0.0, len(x)), s=3, cmap=COLOURMAP, zorder=2)
            axes.plot(x[-1], y[-1], "o", color="crimson", markersize=3, zorder=3)
    figure.supxlabel("first principal component of z", fontsize="small")
    figure.supylabel("second principal component of z", fontsize="small")
    return figure


def plot_paths(demos: Demos, embedding: Embedding) -> matplotlib.figure.Figure:
    """Demonstrations in state space and in z, each on two principal components."""
    figure = matplotlib.figure.Figure(figsize=(9, 4.3), layout="constrained")
    standard = demos.states / demos.states.std(axis=0)
    longest = max(float(demos.episode(i).times[-1]) for i in range(len(demos)))
    for axes, title, points in zip(
        figure.subplots(1, 2),
        ("standardised state", "plan space z"),
        (standard, embedding.encode(demos.states)),
        strict=True,
    ):
        flat, _ = principal_components(points, 2)
        for i in range(min(len(demos), MAX_PATHS)):
            a, b = demos.offsets[i], demos.offsets[i + 1]
            left = demos.times[b - 1] - demos.times[a:b]
            axes.plot(*flat[a:b].T, color="0.85", linewidth=0.6, zorder=1)
            axes.scatter(*flat[a:b].T, c=left, s=4, cmap=COLOURMAP, vmin=0, vmax=longest, zorder=2)
            axes.plot(*flat[b - 1], "o", color="crimson", markersize=3.5, zorder=3)
        axes.set_title(title, loc="left")
        axes.set_xlabel("first principal component")
        axes.set_ylabel("second principal component")
        axes.spines[["top", "right"]].set_visible(False)
    figure.colorbar(time_left_scale(longest), ax=figure.axes, label="time left [s]")
    return figure


def _faint(colour: str) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"


def _flat_layout(num: int) -> dict[str, Any]:
    """Layout of `num` curves: `plain_layout` with grid lines that are visible in light and dark mode.

    The legend is below the curves, and the figure is higher the more names it has: on a phone, each name has
    a line of its own.
    """
    lines = {"gridcolor": "rgba(136,136,136,0.3)", "zerolinecolor": "rgba(136,136,136,0.5)"}
    plain = plain_layout()
    legend = {**plain["legend"], "yanchor": "top", "y": -0.18}
    height = plain["height"] + LEGEND_LINE * max(0, num - FREE_NAMES)
    return {**plain, "legend": legend, "height": height, "xaxis": lines, "yaxis": lines}


def plain_layout() -> dict[str, Any]:
    """Layout of all interactive figures. It suits light and dark mode."""
    return {
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": "#888", "family": "system-ui, sans-serif"},
        "margin": {"l": 50, "r": 20, "t": 20, "b": 50},
        "legend": {"orientation": "h", "y": 1.08},
        "modebar": {"bgcolor": "rgba(0,0,0,0)"},
        "height": 460,
    }
