"""Draw learning curves as the paper does: the mean over seeds, a band over seeds, and the best seed."""

from collections.abc import Mapping

import matplotlib.figure

from planspace.figures.style import COLOURS
from planspace.rl.learning_curve import SMOOTHING, Curve

MAX_BANDS = 6
"""With more arms than this in one figure, only the means are drawn: bands would hide each other."""
STYLES = ("-", "--", ":")
"""Line styles that tell arms of the same colour apart."""

MEAN_RETURN = f"episode return, mean over {SMOOTHING} iterations"


def plot_curves(
    curves: Mapping[str, Curve], title: str, shown: str = MEAN_RETURN
) -> matplotlib.figure.Figure:
    """Draw the learning curves of several arms.

    Args:
        curves: a curve for each label in the legend.
        title: the title of the figure.
        shown: what the curves show, for the axis.
    """
    with_bands = len(curves) <= MAX_BANDS
    figure = matplotlib.figure.Figure(figsize=(7 if with_bands else 9.5, 4.3), layout="constrained")
    axes = figure.subplots()
    for i, (label, curve) in enumerate(curves.items()):
        steps, colour = curve.steps / 1e6, COLOURS[i % len(COLOURS)]
        style = "-" if with_bands else STYLES[i // len(COLOURS) % len(STYLES)]
        axes.plot(steps, curve.mean, color=colour, linewidth=2, linestyle=style, label=label)
        if with_bands:
            axes.fill_between(steps, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)
            axes.plot(steps, curve.best, color=colour, linewidth=1, linestyle="--")
    axes.set_xlabel("environment steps per seed [million]")
    axes.set_ylabel(shown)
    axes.set_title(title, loc="left", pad=16)
    key = "solid: mean over seeds" if with_bands else "line: mean over seeds"
    if with_bands:
        key += "; band: second worst to second best seed; dashed: best seed"
    axes.text(0.0, 1.005, key, transform=axes.transAxes, fontsize="x-small", color="0.4", va="bottom")
    axes.spines[["top", "right"]].set_visible(False)
    if with_bands:
        axes.legend(frameon=False)
    else:
        figure.legend(frameon=False, fontsize="small", loc="outside right upper")
    return figure
