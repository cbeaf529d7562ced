"""An embedding as pictures: demonstrations as paths in z, and distance against time."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib.cm
import matplotlib.colors
import matplotlib.figure
import matplotlib.ticker
import numpy as np
import plotly.graph_objects as go
import plotly.io
from jaxtyping import Float, Int
from matplotlib.collections import LineCollection
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.figures.demos import COLOURMAP, time_left_scale

MAX_DRAWN = 100
"""More paths than this are a blot; the first ones are drawn."""
MAX_INTERACTIVE = 200
MAX_VECTOR = 20_000
"""More pieces of line than this are one picture inside an SVG file, which stays small."""
END_COLOUR, DIAGONAL_COLOUR = "crimson", "black"
THINNEST = 0.25
"""A box in space is at least so thin beside its longest side."""
PLOTLY_CONFIG = {"displaylogo": False, "responsive": True, "scrollZoom": True, "showSendToCloud": False}
"""Plotly 7 has a button that sends the data to its maker, unless it is told not to."""
CAMERA = {"eye": {"x": 1.6, "y": -1.7, "z": 0.9}, "center": {"x": 0, "y": 0, "z": -0.1}}
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'
'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; worker-src blob:">
<title>{title}</title>
<style>
  body {{ margin: 1.5rem; font: 16px/1.5 system-ui, sans-serif; color: #1c2430; background: white; }}
  h1 {{ font-size: 1.3rem; margin: 0; }} p {{ margin: 0; color: #5c6778; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>In a perfect plan space each is a straight line, run through at constant speed.
{gesture} to read the state.</p>
{picture}
</body>
</html>
"""
"""The page's policy forbids it to load anything."""


# --- paths in z -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Paths:
    """Demonstrations in the coordinates they are drawn in."""

    demos: Demos
    """With the states the embedding reads."""
    numbers: tuple[int, ...]
    """Which demonstrations."""
    points: list[Float[np.ndarray, "_time axis"]]
    """One array for each."""
    labels: tuple[str, ...]
    """Of the two or three axes."""
    title: str
    longest: float
    """The longest duration [s]."""
    against_time: bool
    """Whether the first axis is time."""

    @property
    def in_space(self) -> bool:
        """Whether there are three axes."""
        return len(self.labels) == 3

    def time_left(self, i: int) -> Float[np.ndarray, " time"]:
        """Of the i-th that is drawn [s]."""
        times = self.demos.episode(self.numbers[i]).times
        return times[-1] - times


def plot_paths(
    embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"]
) -> matplotlib.figure.Figure:
    """Draws demonstrations as the embedding sees them, coloured by the time left, ends marked.

    A z of one number is drawn against time, of two in the plane, of three in space; above that, the first
    three principal components of its mean are.

    Args:
        embedding: what makes z.
        demos: the demonstrations.
        episodes: which of them; the first `MAX_DRAWN` are drawn.

    Raises:
        PlanspaceError: the demos lack a state the embedding reads.
    """
    paths = _paths(embedding, demos, episodes, MAX_DRAWN)
    figure = matplotlib.figure.Figure(figsize=(7.6, 5.6), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d" if paths.in_space else None)
    pieces = np.concatenate([np.stack([p[:-1], p[1:]], axis=1) for p in paths.points])
    left = np.concatenate([paths.time_left(i)[:-1] for i in range(len(paths.points))])
    kind = Line3DCollection if paths.in_space else LineCollection
    scale = time_left_scale(paths.longest)
    lines = kind(list(pieces), cmap=COLOURMAP, norm=scale.norm, linewidths=1.2, alpha=0.9)
    lines.set_array(left)
    lines.set_rasterized(len(pieces) > MAX_VECTOR)
    axes.add_collection(lines)
    ends = np.stack([p[-1] for p in paths.points])
    (mark,) = axes.plot(*ends.T, "o", color=END_COLOUR, markersize=4, label="end of a demonstration")
    _frame(axes, paths)
    figure.suptitle(paths.title, x=0.02, ha="left")
    figure.legend(handles=[mark], loc="outside lower left", frameon=False)
    figure.colorbar(scale, ax=axes, label="time left [s]", shrink=0.75, pad=0.12 if paths.in_space else 0.02)
    return figure


def interactive_paths(embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"]) -> go.Figure:
    """The same to turn and hover over.

    Args:
        embedding: what makes z.
        demos: the demonstrations.
        episodes: which of them; the first `MAX_INTERACTIVE` are drawn.

    Raises:
        PlanspaceError: the demos lack a state the embedding reads.
    """
    return _interactive(_paths(embedding, demos, episodes, MAX_INTERACTIVE))


def paths_html(embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"]) -> str:
    """`interactive_paths` as an HTML page that needs nothing beside it."""
    paths = _paths(embedding, demos, episodes, MAX_INTERACTIVE)
    picture = plotly.io.to_html(
        _interactive(paths),
        include_plotlyjs=True,
        full_html=False,
        default_height="80vh",
        config=PLOTLY_CONFIG,
    )
    gesture = "Drag to turn, scroll to come closer, hover" if paths.in_space else "Hover"
    return PAGE.format(title=html.escape(paths.title), gesture=gesture, picture=picture)


def _interactive(paths: _Paths) -> go.Figure:
    figure = go.Figure(_interactive_lines(paths))
    ends = [np.round(p[-1], 4).tolist() for p in paths.points]
    mark = {"size": 4 if paths.in_space else 8, "color": END_COLOUR}
    add = figure.add_scatter3d if paths.in_space else figure.add_scatter
    add(**_coordinates(ends), mode="markers", name="end of a demonstration", marker=mark, hoverinfo="skip")
    figure.update_layout(_interactive_layout(paths))
    return figure


def _paths(embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"], most: int) -> _Paths:
    demos = demos.select(embedding.inputs.names)
    drawn = episodes[:most]
    parts = [demos.episode(int(i)) for i in drawn]
    z = embedding.encode(demos.states[demos.rows(drawn)])
    if embedding.z_dim == 1:
        z = np.stack([np.concatenate([e.times for e in parts]), z[:, 0]], axis=1)
        labels = ("time [s]", "z")
    elif embedding.z_dim <= 3:
        labels = tuple(f"z{k + 1}" for k in range(embedding.z_dim))
    else:
        z, shares = principal(z, 3)
        labels = tuple(f"z component {k + 1} ({_percent(share)})" for k, share in enumerate(shares))
    which = f"{len(drawn)} demonstrations" if len(drawn) > 1 else "A demonstration"
    if len(drawn) < len(episodes):
        which = f"The first {len(drawn)} of {len(episodes)} demonstrations"
    about = f" of {demos.info.problem}" if demos.info.problem else ""
    against = " against time" if embedding.z_dim == 1 else ""
    return _Paths(
        demos=demos,
        numbers=tuple(map(int, drawn)),
        points=np.split(z, np.cumsum([len(e.states) for e in parts])[:-1]),
        labels=labels,
        title=f"{which}{about} in plan space{against}, z of {embedding.z_dim}",
        longest=max(float(e.times[-1]) for e in parts),
        against_time=embedding.z_dim == 1,
    )


def principal(
    x: Float[np.ndarray, "row z"], num: int
) -> tuple[Float[np.ndarray, "row num"], Float[np.ndarray, " num"]]:
    """The first principal components, if there are so many, and each one's share of the variance."""
    centred = x - x.mean(axis=0)
    _, values, axes = np.linalg.svd(centred, full_matrices=False)
    total = np.sum(values**2)
    return centred @ axes[:num].T, values[:num] ** 2 / (total if total > 0 else 1.0)


def _percent(share: float) -> str:
    return "< 1 %" if 0 < share < 0.005 else f"{100 * share:.0f} %"


def _frame(axes: Any, paths: _Paths) -> None:
    """Labels and proportions; a length in z is as long in every direction."""
    for name, label in zip("xyz", paths.labels, strict=False):
        axes.set(**{f"{name}label": label})
    if not paths.in_space:
        axes.margins(0.04)
        axes.spines[["top", "right"]].set_visible(False)
        if not paths.against_time:
            axes.set_aspect("equal", adjustable="datalim")
        return
    points = np.concatenate(paths.points)
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, THINNEST * (np.max(high - low) or 1.0)) * 1.04
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


def _interactive_lines(paths: _Paths) -> Any:
    """All paths as one broken line, whose points know their demonstration, time and state."""
    gap, rows, colours, points = [None], [], [], []
    for i, number in enumerate(paths.numbers):
        episode, left = paths.demos.episode(number), paths.time_left(i)
        about = np.column_stack([np.full(len(left), number), episode.times, left, episode.states])
        rows += [*np.round(about, 4).tolist(), gap * about.shape[1]]
        colours += [*np.round(left, 4).tolist(), 0.0]
        points += [*np.round(paths.points[i], 4).tolist(), gap * len(paths.labels)]
    info = paths.demos.info
    states = [
        f"{_plain(name)} %{{customdata[{k}]:.3f}} {_plain(unit)}"
        for k, (name, unit) in enumerate(zip(info.names, info.units, strict=True), start=3)
    ]
    time = "%{customdata[1]:.2f} s, %{customdata[2]:.2f} s left"
    colour = {
        "color": colours,
        "colorscale": "Viridis",
        "reversescale": True,
        "cmin": 0,
        "cmax": paths.longest,
    }
    bar = {"title": "time left [s]", "thickness": 14, "len": 0.7}
    common = {
        **_coordinates(points),
        "mode": "lines+markers",
        "showlegend": False,
        "customdata": rows,
        "hovertemplate": "<br>".join(["demonstration %{customdata[0]}", time, *states]) + "<extra></extra>",
    }
    if paths.in_space:
        marker = {**colour, "size": 2, "colorbar": bar}
        return go.Scatter3d(**common, line={**colour, "width": 4}, marker=marker)
    return go.Scatter(
        **common, line={"color": "#c5ccd6", "width": 1}, marker={**colour, "size": 5, "colorbar": bar}
    )


def _interactive_layout(paths: _Paths) -> dict[str, Any]:
    grid: dict[str, Any] = {"gridcolor": "#d9dee6", "zerolinecolor": "#d9dee6"}
    if paths.in_space:
        grid |= {"showbackground": False, "nticks": 6}
    axes: dict[str, Any] = {
        f"{name}axis": {"title": {"text": label}, **grid}
        for name, label in zip("xyz", paths.labels, strict=False)
    }
    if paths.in_space:
        axes = {"scene": {**axes, "aspectmode": "data", "camera": CAMERA}}
    elif not paths.against_time:
        axes["yaxis"]["scaleanchor"] = "x"
    return {
        **axes,
        "plot_bgcolor": "white",
        "font": {"family": "system-ui, sans-serif", "size": 13},
        "margin": {"l": 60, "r": 20, "t": 40, "b": 50},
        "legend": {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"},
    }


def _coordinates(points: Sequence[Sequence[float | None]]) -> dict[str, Any]:
    return dict(zip("xyz", zip(*points, strict=True), strict=False))


def _plain(text: str) -> str:
    """Text that Plotly's hover shows as it is."""
    return "".join(c if c.isalnum() or c in " _-/.^" else f"&#{ord(c)};" for c in text)


# --- distance against time --------------------------------------------------------------------------


def plot_distance_against_time(
    embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"]
) -> matplotlib.figure.Figure:
    """Draws how far each state is from its demonstration's end, against the time left, in z and in the state.

    Distances are counted in the mean distance from start to end, times in the mean duration, so that straight
    lines run through at one constant speed lie on the diagonal. The state is standardised by all `demos`.

    Args:
        embedding: what makes z.
        demos: the demonstrations.
        episodes: which of them; the first `MAX_DRAWN` are drawn, all of them make the means.

    Raises:
        PlanspaceError: the demos lack a state the embedding reads.
    """
    demos = demos.select(embedding.inputs.names)
    parts = [demos.episode(int(i)) for i in episodes]
    deviation = demos.states.std(axis=0)
    deviation = np.where(deviation > 0, deviation, 1.0)
    durations = np.array([e.times[-1] for e in parts])
    figure = matplotlib.figure.Figure(figsize=(10, 5), layout="constrained")
    left_axes, right_axes = figure.subplots(1, 2, sharex=True, sharey=True)
    norm = matplotlib.colors.Normalize(durations.min(), durations.max())
    for axes, title, letter, paths in (
        (left_axes, "in plan space", "z", [embedding.encode(e.states) for e in parts]),
        (right_axes, "in the standardised state", "x", [e.states / deviation for e in parts]),
    ):
        far = [np.linalg.norm(p - p[-1], axis=1) for p in paths]
        scale = np.mean([d[0] for d in far]) or 1.0
        curves = [
            np.column_stack([(e.times[-1] - e.times) / durations.mean(), d / scale])
            for e, d in zip(parts, far, strict=True)
        ]
        lines = LineCollection(curves[:MAX_DRAWN], cmap=COLOURMAP, norm=norm, linewidths=0.8, alpha=0.7)
        lines.set_array(durations[:MAX_DRAWN])
        lines.set_rasterized(sum(map(len, curves[:MAX_DRAWN])) > MAX_VECTOR)
        axes.add_collection(lines)
        _diagonal(axes, float(durations.max() / durations.mean()))
        axes.set_title(title, loc="left")
        axes.set_ylabel(f"$|{letter}_t - {letter}_T|$, over the mean of $|{letter}_0 - {letter}_T|$")
        axes.set_xlabel(f"time left, over the mean duration of {durations.mean():.3g} s")
        axes.spines[["top", "right"]].set_visible(False)
    left_axes.set(xlim=(0, None), ylim=(0, None))
    which = f"{len(parts)} demonstrations"
    if len(parts) > MAX_DRAWN:
        which = f"the first {MAX_DRAWN} of {which}"
    figure.suptitle(f"Distance to the end against the time left, {which}", x=0.02, ha="left")
    mappable = matplotlib.cm.ScalarMappable(norm, COLOURMAP)
    figure.colorbar(mappable, ax=[left_axes, right_axes], label="duration of the demonstration [s]")
    figure.legend(handles=left_axes.get_legend_handles_labels()[0], loc="outside lower left", frameon=False)
    return figure


def _diagonal(axes: Any, longest: float) -> None:
    axes.plot(
        [0, longest],
        [0, longest],
        color=DIAGONAL_COLOUR,
        linestyle="--",
        linewidth=1.4,
        label="a straight line run through at one constant speed",
    )
