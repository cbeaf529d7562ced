"""The study's figures: matplotlib for paper and README, Plotly for the report one can hover over."""

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
from planspace.embed.plot import principal
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
        xaxis_title="environment steps a seed", yaxis_title="return of an episode", **plain_layout()
    )
    return figure


def plot_paths(demos: Demos, embedding: Embedding) -> matplotlib.figure.Figure:
    """A demonstration's straightness at a glance: the state beside z, each on two principal components."""
    figure = matplotlib.figure.Figure(figsize=(9, 4.3), layout="constrained")
    standard = demos.states / demos.states.std(axis=0)
    longest = max(float(demos.episode(i).times[-1]) for i in range(len(demos)))
    for axes, title, points in zip(
        figure.subplots(1, 2),
        ("standardised state", "plan space z"),
        (standard, embedding.encode(demos.states)),
        strict=True,
    ):
        flat, _ = principal(points, 2)
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


def _faint(colour: str) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"


def plain_layout() -> dict[str, Any]:
    """A layout that fits the report by day and by night."""
    return {
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": "#888", "family": "system-ui, sans-serif"},
        "margin": {"l": 50, "r": 20, "t": 20, "b": 50},
        "legend": {"orientation": "h", "y": 1.08},
        "modebar": {"bgcolor": "rgba(0,0,0,0)"},
        "height": 460,
    }
