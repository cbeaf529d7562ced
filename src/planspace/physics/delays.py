"""The controls that a delay holds back: actuators with `delay` apply the control of some steps ago.

MuJoCo keeps, for each actuator with a delay, its last controls with their times in `history`:

    [a number of the user's, the index of the newest, times of the n samples, values of the n samples]

The samples are a ring. A state has the values, oldest first; their times follow from the time step. MuJoCo
looks a control up by its time, so rounding of the time must not decide which one it finds. This holds for the
delays that `physics.supported` accepts: there, it always finds the oldest one.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

HEADER = 2
"""Numbers before the samples of an actuator in `history`."""


class Delays(NamedTuple):
    """The actuators of a model that have a delay."""

    actuators: Int[np.ndarray, " actuator"]
    """Their numbers."""
    addresses: Int[np.ndarray, " actuator"]
    """Where each begins in `history`."""
    counts: Int[np.ndarray, " actuator"]
    """The number of controls that each keeps."""
    step: float
    """The model's time step [s]."""

    @property
    def size(self) -> int:
        """Number of values in a state."""
        return int(self.counts.sum())

    def write(self, values: Float[np.ndarray, "*batch value"], history: np.ndarray) -> None:
        """Write values into an array shaped like MuJoCo's history, as if the time were 0."""
        first = 0
        for start, count in zip(self.addresses, self.counts, strict=True):
            times = start + HEADER
            history[..., start], history[..., start + 1] = 0.0, count - 1
            history[..., times : times + count] = -self.step * np.arange(count, 0, -1)
            history[..., times + count : times + 2 * count] = values[..., first : first + count]
            first += count

    def read(self, history: Float[np.ndarray, "*batch number"]) -> Float[np.ndarray, "*batch value"]:
        """Read the values from an array shaped like MuJoCo's history."""
        parts = []
        for start, count in zip(self.addresses, self.counts, strict=True):
            newest = history[..., start + 1, None].astype(int)
            ring = history[..., start + HEADER + count : start + HEADER + 2 * count]
            parts.append(np.take_along_axis(ring, (newest + 1 + np.arange(count)) % count, axis=-1))
        return np.concatenate(parts, axis=-1)


_NONE = np.zeros(0, dtype=int)
NO_DELAYS = Delays(_NONE, _NONE, _NONE, 0.0)


def read_delays(model: mujoco.MjModel) -> Delays:
    """Return the actuators of a model that have a delay."""
    if not model.nhistory or not (found := np.flatnonzero(model.actuator_delay > 0)).size:
        return NO_DELAYS
    counts, addresses = model.actuator_history[found, 0].astype(int), model.actuator_historyadr[found]
    return Delays(found, addresses.astype(int), counts, float(model.opt.timestep))
