"""The figures: matplotlib for paper and README, Plotly for the report one can turn and hover over."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.figure
import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.plot import COLOURMAP, time_left_scale
from planspace.embed.embedding import Embedding
from planspace.store import Arrays, write_bytes

SMOOTHING = 10
"""Iterations in the moving average of a learning curve."""
MAX_PATHS = 20
"""More paths than this hide each other in a flat picture; the first ones are drawn."""
COLOURS = ("#4477aa", "#ee7733", "#228833", "#aa3377", "#66ccee", "#bbbb33")
"""Told apart by colour-blind readers (after Paul Tol)."""


@dataclass(frozen=True)
class Curve:
    """A learning curve in the paper's manner."""

    steps: Int[np.ndarray, " iteration"]
    """Environment steps a seed."""
    mean: Float[np.ndarray, " iteration"]
    """Mean over seeds of the smoothed returns."""
    low: Float[np.ndarray, " iteration"]
    """The second worst seed at each step (the worst, with fewer than four seeds)."""
    high: Float[np.ndarray, " iteration"]
    """The second best, likewise."""
    best: Float[np.ndarray, " iteration"]
    """The run that reached the highest smoothed return at any step."""


def learning_curve(history: Arrays) -> Curve:
    """Smooths each seed's returns and summarises them over seeds."""
    smooth = smoothed(history["return"])
    ranked = np.sort(smooth, axis=1)
    trim = 1 if smooth.shape[1] >= 4 else 0
    return Curve(
        steps=history["steps"],
        mean=smooth.mean(axis=1),
        low=ranked[:, trim],
        high=ranked[:, -1 - trim],
        best=smooth[:, int(smooth.max(axis=0).argmax())],
    )


def smoothed(returns: Float[np.ndarray, "iteration seed"]) -> Float[np.ndarray, "iteration seed"]:
    """Mean over the last `SMOOTHING` iterations, or as many as there are."""
    total = np.cumsum(np.vstack([np.zeros((1, returns.shape[1])), returns]), axis=0)
    stop = np.arange(1, len(returns) + 1)
    start = np.maximum(stop - SMOOTHING, 0)
    return (total[stop] - total[start]) / (stop - start)[:, None]


def plot_curves(curves: Mapping[str, Curve], title: str) -> matplotlib.figure.Figure:
    """Learning curves of several arms."""
    figure = matplotlib.figure.Figure(figsize=(7, 4.3), layout="constrained")
    axes = figure.subplots()
    for colour, (label, curve) in zip(COLOURS, curves.items(), strict=False):
        steps = curve.steps / 1e6
        axes.fill_between(steps, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(steps, curve.mean, color=colour, linewidth=2, label=label)
        axes.plot(steps, curve.best, color=colour, linewidth=1, linestyle="--")
    axes.set_xlabel("environment steps a seed [million]")
    axes.set_ylabel("return of an episode")
    axes.set_title(title, loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    return figure


def interactive_curves(curves: Mapping[str, Curve]) -> go.Figure:
    """The same, to hover over."""
    figure = go.Figure()
    for colour, (label, c) in zip(COLOURS, curves.items(), strict=False):
        band = {"mode": "lines", "line_width": 0, "hoverinfo": "skip", "legendgroup": label}
        figure.add_scatter(x=c.steps, y=c.high, showlegend=False, **band)
        figure.add_scatter(
            x=c.steps, y=c.low, fill="tonexty", fillcolor=_faint(colour), showlegend=False, **band
        )
        figure.add_scatter(
            x=c.steps,
            y=c.mean,
            name=label,
            legendgroup=label,
            mode="lines",
            line={"color": colour, "width": 3},
        )
        figure.add_scatter(
            x=c.steps,
            y=c.best,
            name=f"{label}, best run",
            legendgroup=label,
            showlegend=False,
            mode="lines",
            line={"color": colour, "width": 1, "dash": "dash"},
        )
    figure.update_layout(
        xaxis_title="environment steps a seed", yaxis_title="return of an episode", **_plain_layout()
    )
    return figure


def interactive_paths(demos: Demos, embedding: Embedding) -> go.Figure:
    """Demonstrations in z, coloured by the time left, the goal marked; principal components above 3-D."""
    episodes = [demos.episode(i) for i in range(len(demos))]
    paths, goals = _paths_3d(demos, embedding)
    longest = max(float(e.times[-1]) for e in episodes)
    figure = go.Figure()
    for episode, z in zip(episodes, paths, strict=True):
        left = np.round(episode.times[-1] - episode.times, 3)
        figure.add_scatter3d(
            x=z[:, 0],
            y=z[:, 1],
            z=z[:, 2],
            mode="lines",
            showlegend=False,
            line={
                "color": left,
                "colorscale": "Viridis",
                "reversescale": True,
                "cmin": 0,
                "cmax": longest,
                "width": 4,
            },
            text=left,
            hovertemplate="%{text} s to go<extra></extra>",
        )
    figure.add_scatter3d(
        x=goals[:, 0],
        y=goals[:, 1],
        z=goals[:, 2],
        mode="markers",
        name="goal",
        marker={"size": 7, "color": "crimson", "symbol": "diamond"},
    )
    figure.add_scatter3d(  # an empty trace that carries the colour bar
        x=[None],
        y=[None],
        z=[None],
        mode="markers",
        showlegend=False,
        marker={
            "color": [0],
            "colorscale": "Viridis",
            "reversescale": True,
            "cmin": 0,
            "cmax": longest,
            "colorbar": {"title": "time left [s]", "thickness": 12},
        },
    )
    axis = {"backgroundcolor": "rgba(0,0,0,0)", "gridcolor": "rgba(128,128,128,0.3)"}
    figure.update_layout(
        scene={
            "xaxis": axis,
            "yaxis": axis,
            "zaxis": axis,
            "aspectmode": "data",
            "camera_eye": {"x": 1, "y": 1, "z": 0.7},
        },
        **_plain_layout(),
    )
    return figure


def plot_paths(demos: Demos, embedding: Embedding) -> matplotlib.figure.Figure:
    """A demonstration's straightness at a glance: the state beside z, each on two principal components."""
    figure = matplotlib.figure.Figure(figsize=(9, 4.3), layout="constrained")
    paths, _ = _paths_3d(demos, embedding)
    standard = (demos.states - demos.states.mean(axis=0)) / demos.states.std(axis=0)
    raw = [standard[a:b] for a, b in zip(demos.offsets[:-1], demos.offsets[1:], strict=True)]
    longest = max(float(demos.episode(i).times[-1]) for i in range(len(demos)))
    for axes, title, lines in zip(
        figure.subplots(1, 2), ("standardised state", "plan space z"), (raw, paths), strict=True
    ):
        flat = _principal(np.concatenate(lines), 2)
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


def save_figure(figure: matplotlib.figure.Figure, folder: Path, name: str) -> Path:
    """Saves a figure as PNG and SVG; returns the PNG's path."""
    for ending in ("svg", "png"):
        buffer = io.BytesIO()
        figure.savefig(buffer, format=ending, dpi=150)
        write_bytes(folder / f"{name}.{ending}", buffer.getvalue())
    return folder / f"{name}.png"


def _paths_3d(demos: Demos, embedding: Embedding) -> tuple[list[np.ndarray], np.ndarray]:
    """Each demonstration in three coordinates of z, and the goals (the ends, where none is known)."""
    ends = demos.states[demos.offsets[1:] - 1]
    goals = np.where(np.isfinite(demos.goals), demos.goals, ends)
    z = embedding.encode(np.concatenate([demos.states, np.unique(goals, axis=0)]))
    if z.shape[1] > 3:
        z = _principal(z, 3)
    elif z.shape[1] < 3:
        z = np.pad(z, ((0, 0), (0, 3 - z.shape[1])))
    paths = [z[a:b] for a, b in zip(demos.offsets[:-1], demos.offsets[1:], strict=True)]
    return paths, z[len(demos.states) :]


def _principal(x: np.ndarray, num: int) -> np.ndarray:
    centred = x - x.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    return centred @ axes[:num].T


def _faint(colour: str) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"


def _plain_layout() -> dict[str, Any]:
    return {
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": "#888", "family": "system-ui, sans-serif"},
        "margin": {"l": 50, "r": 20, "t": 20, "b": 50},
        "legend": {"orientation": "h", "y": 1.08},
        "modebar": {"bgcolor": "rgba(0,0,0,0)"},
        "height": 460,
    }
