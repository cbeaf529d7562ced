"""Angles on the circle; the only module that uses 2 pi."""

import numpy as np
from jaxtyping import Float

TWO_PI = 2.0 * np.pi


def wrap(angle: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Map angles [rad] to (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle, TWO_PI)


def unwrap_to_end(angle: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """Shift a continuous angle by a multiple of 2 pi so that it ends in (-pi, pi].

    A stored episode keeps its angles continuous: wrapping each state would put jumps of 2 pi into the raw
    state and make every comparison with it unfair.
    """
    return angle + (wrap(angle[-1:]) - angle[-1:])
