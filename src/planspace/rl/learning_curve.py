"""Learning curves as the paper reports them: smoothed returns, summarised over seeds."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from planspace.storage.arrays import Arrays

SMOOTHING = 10
"""Number of iterations in the moving average of a learning curve."""


@dataclass(frozen=True)
class Curve:
    """A learning curve, summarised over seeds."""

    steps: Int[np.ndarray, " iteration"]
    """Environment steps per seed."""
    mean: Float[np.ndarray, " iteration"]
    """Mean of the smoothed returns over seeds."""
    low: Float[np.ndarray, " iteration"]
    """Second worst seed at each step; the worst if there are fewer than four seeds."""
    high: Float[np.ndarray, " iteration"]
    """Second best seed at each step; the best if there are fewer than four seeds."""
    best: Float[np.ndarray, " iteration"]
    """The seed with the highest smoothed return at any step."""


def learning_curve(history: Arrays, window: int = SMOOTHING) -> Curve:
    """Smooth the returns of each seed and summarise them over seeds.

    Args:
        history: the arrays `steps` (iteration) and `return` (iteration, seed) of a training run.
        window: number of iterations in the moving average.
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
    """Moving average over the last `window` iterations; the first rows average fewer."""
    stops = range(1, len(returns) + 1)
    return np.stack([returns[max(stop - window, 0) : stop].mean(axis=0) for stop in stops])
