"""Controls over a horizon, described by a few knots: matrices that turn knots into controls and move them."""

from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

SplineOrder = Literal["zero", "linear", "cubic"]
"""How controls run between knots: held until the next one, straight, or as a cubic spline."""


def spline_matrix(
    times: Float[np.ndarray, " time"], horizon: float, num_knots: int, order: SplineOrder
) -> Float[np.ndarray, "time knot"]:
    """Return the matrix that turns the values of knots into values at some times.

    Args:
        times: times from now [s]; after the last knot, its value holds.
        horizon: time of the last knot [s]; the first is now, and the others are evenly spaced.
        num_knots: number of knots; a single one holds its value.
        order: how values run between knots.
    """
    if num_knots == 1 or horizon <= 0:
        return np.eye(num_knots)[np.zeros(len(times), int)]
    knots = np.linspace(0.0, horizon, num_knots)
    within = np.clip(times, 0.0, horizon)
    if order == "cubic" and num_knots > 2:
        return np.asarray(CubicSpline(knots, np.eye(num_knots), bc_type="natural")(within))
    place = within / horizon * (num_knots - 1)
    left = np.minimum(np.floor(place + 1e-9).astype(int), num_knots - 1)
    if order == "zero":
        return np.eye(num_knots)[left]
    right = np.minimum(left + 1, num_knots - 1)
    fraction = np.clip(place - left, 0.0, 1.0)[:, None]
    return (1 - fraction) * np.eye(num_knots)[left] + fraction * np.eye(num_knots)[right]
