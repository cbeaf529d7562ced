"""Learning curves in the paper's manner: the mean over seeds of smoothed returns, shaded from the second
worst to the second best seed, and dashed the run with the highest smoothed return at any point.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import matplotlib.figure
import numpy as np
from jaxtyping import Float, Int

from planspace.figures.style import COLOURS
from planspace.storage.arrays import Arrays

SMOOTHING = 10
"""Iterations in the moving average of a learning curve."""
MAX_BANDS = 6
"""Of more arms in one figure the means alone are drawn: bands would hide each other."""
STYLES = ("-", "--", ":")
"""Lines that share a colour."""


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


def learning_curve(history: Arrays, window: int = SMOOTHING) -> Curve:
    """Smooths each seed's returns and summarises them over seeds.

    Args:
        history: `steps` and `return`, as `train` returns them.
        window: iterations in the moving average.
    """
    smooth = smoothed(history["return"], window)
    ranked = np.sort(smooth, axis=1)
    trim = 1 if smooth.shape[1] >= 4 else 0
    return Curve(
        steps=history["steps"],
        mean=smooth.mean(axis=1),
        low=ranked[:, trim],
        high=ranked[:, -1 - trim],
        best=smooth[:, int(smooth.max(axis=0).argmax())],
    )


def smoothed(
    returns: Float[np.ndarray, "iteration seed"], window: int = SMOOTHING
) -> Float[np.ndarray, "iteration seed"]:
    """Mean over the last `window` iterations, or as many as there are."""
    stops = range(1, len(returns) + 1)
    return np.stack([returns[max(stop - window, 0) : stop].mean(axis=0) for stop in stops])


def plot_curves(curves: Mapping[str, Curve], title: str) -> matplotlib.figure.Figure:
    """Learning curves of several arms."""
    figure = matplotlib.figure.Figure(
        figsize=(7 if len(curves) <= MAX_BANDS else 9.5, 4.3), layout="constrained"
    )
    axes = figure.subplots()
    for i, (label, curve) in enumerate(curves.items()):
        steps, colour = curve.steps / 1e6, COLOURS[i % len(COLOURS)]
        style = "-" if len(curves) <= MAX_BANDS else STYLES[i // len(COLOURS) % len(STYLES)]
        axes.plot(steps, curve.mean, color=colour, linewidth=2, linestyle=style, label=label)
        if len(curves) <= MAX_BANDS:
            axes.fill_between(steps, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)
            axes.plot(steps, curve.best, color=colour, linewidth=1, linestyle="--")
    axes.set_xlabel("environment steps a seed [million]")
    axes.set_ylabel(f"return of an episode, mean of {SMOOTHING} iterations")
    axes.set_title(title, loc="left", pad=16)
    how = "line: mean of the seeds"
    if len(curves) <= MAX_BANDS:
        how += "; band: second worst to second best; dashed: the run that was best"
    axes.text(0.0, 1.005, how, transform=axes.transAxes, fontsize="x-small", color="0.4", va="bottom")
    axes.spines[["top", "right"]].set_visible(False)
    if len(curves) <= MAX_BANDS:
        axes.legend(frameon=False)
    else:
        figure.legend(frameon=False, fontsize="small", loc="outside right upper")
    return figure
