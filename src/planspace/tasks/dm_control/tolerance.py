"""How DeepMind Control turns a quantity into a reward between 0 and 1.

Source: Tassa et al. 2018, "DeepMind Control Suite", section 2 (arXiv:1801.00690).
"""

import numpy as np
from jaxtyping import Float

VALUE_AT_MARGIN = 0.1
"""The reward at one margin outside of the bounds."""


def within(values: np.ndarray, low: float, high: float, margin: float = 0.0) -> Float[np.ndarray, "*shape"]:
    """Return 1 between `low` and `high`, and outside a Gaussian of the distance; 0 without a margin.

    Args:
        values: the quantity [*shape].
        low: lower bound.
        high: upper bound.
        margin: distance from the bounds at which the Gaussian is `VALUE_AT_MARGIN`.
    """
    inside = (low <= values) & (values <= high)
    if margin == 0.0:
        return inside.astype(float)
    outside = np.where(values < low, low - values, values - high) / margin
    return np.where(inside, 1.0, np.exp(np.log(VALUE_AT_MARGIN) * outside**2))


def small(values: np.ndarray) -> Float[np.ndarray, "*shape"]:
    """Return 1 at 0, falling as a parabola to 0 at plus and minus 1."""
    return np.maximum(1.0 - values**2, 0.0)
