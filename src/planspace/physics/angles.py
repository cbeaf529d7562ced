"""Angles on the circle; the only place that knows about 2 pi."""

import numpy as np
from jaxtyping import Float

TWO_PI = 2.0 * np.pi


def wrap(angle: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Maps angles [rad] to (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle, TWO_PI)


def unwrap_to_end(angle: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """Shifts a continuous angle by one multiple of 2 pi so that it ends in (-pi, pi].

    A stored episode keeps its angle continuous: wrapping each state would put jumps of 2 pi into the raw
    state and make every comparison with it unfair.
    """
    return angle + (wrap(angle[-1:]) - angle[-1:])
