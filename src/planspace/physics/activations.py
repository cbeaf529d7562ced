"""The activations of a model's actuators: names and ranges.

An actuator with a filter, an integrator or a muscle has a state of its own, its activation, which makes the
force. MuJoCo keeps the activations of all actuators in `act`.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.mjcf.hold import activated

_DYN = mujoco.mjtDyn
DYNAMICS = {
    int(_DYN.mjDYN_INTEGRATOR): "integrator",
    int(_DYN.mjDYN_FILTER): "filter",
    int(_DYN.mjDYN_FILTEREXACT): "filterexact",
    int(_DYN.mjDYN_MUSCLE): "muscle",
}
"""The values of `dyntype` that can be planned for, and their names in MJCF."""
FILTERS = (int(_DYN.mjDYN_FILTER), int(_DYN.mjDYN_FILTEREXACT))
INTEGRATOR, MUSCLE = int(_DYN.mjDYN_INTEGRATOR), int(_DYN.mjDYN_MUSCLE)


class Activations(NamedTuple):
    """The activations of a model, in the order of `act`."""

    names: tuple[str, ...]
    """`act_` and the name of the actuator, or its number from 1 if it has no name."""
    low: Float[np.ndarray, " activation"]
    """Lower bounds of the values that an activation takes; minus infinity if the model has no limit."""
    high: Float[np.ndarray, " activation"]
    """Upper bounds."""

    @property
    def weights(self) -> Float[np.ndarray, " activation"]:
        """Weights for the neighbour search with which each activation spans 2; 0 without limits."""
        width = self.high - self.low
        return np.divide(2.0, width, out=np.zeros_like(width), where=width > 0)


NO_ACTIVATIONS = Activations((), np.empty(0), np.empty(0))


def read_activations(model: mujoco.MjModel) -> Activations:
    """Return the activations of all actuators of a model.

    A filter follows its control, so it stays within the range of the control. A muscle stays between 0 and 1.
    """
    actuators = activated(model)
    if not len(actuators):
        return NO_ACTIVATIONS
    names = []
    for i in dict.fromkeys(actuators.tolist()):
        name, count = f"act_{model.actuator(i).name or i + 1}", int(model.actuator_actnum[i])
        names += [name] if count == 1 else [f"{name}_{k + 1}" for k in range(count)]
    kinds = model.actuator_dyntype[actuators]
    follows = np.isin(kinds, FILTERS) & (model.actuator_ctrllimited[actuators] != 0)
    low, high = np.where(follows[:, None], model.actuator_ctrlrange[actuators], [-np.inf, np.inf]).T
    low, high = np.where(kinds == MUSCLE, 0.0, low), np.where(kinds == MUSCLE, 1.0, high)
    limited = model.actuator_actlimited[actuators, None] != 0
    least, most = np.where(limited, model.actuator_actrange[actuators], [-np.inf, np.inf]).T
    return Activations(tuple(names), np.clip(low, least, most), np.clip(high, least, most))
