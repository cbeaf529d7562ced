"""The activations of a model's actuators: names and ranges.

An actuator with a filter, an integrator or a muscle has a state of its own, its activation, which makes the
force. MuJoCo keeps the activations of all actuators in `act`. The controls that a delay holds back are
listed with them; see `physics.delays`.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from planspace.mjcf.hold import activated
from planspace.physics.delays import NO_DELAYS, Delays, read_delays

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
    """The activations of a model in the order of `act`, then the controls that delays hold back."""

    names: tuple[str, ...]
    """`act_` and the name of the actuator, or its number from 1 if it has no name; `ctrl_NAME_3` is the
    control of three steps ago."""
    low: Float[np.ndarray, " activation"]
    """Lower bounds of the values that an activation takes; minus infinity if the model has no limit."""
    high: Float[np.ndarray, " activation"]
    """Upper bounds."""
    weights: Float[np.ndarray, " activation"]
    """Weights for the neighbour search with which each activation, and all controls of a delay together, span
    2; 0 without limits."""
    actuators: Int[np.ndarray, " activation"]
    """The number of the actuator that each belongs to."""
    delays: Delays
    """The actuators with a delay, whose last controls come last."""


NO_ACTIVATIONS = Activations((), np.empty(0), np.empty(0), np.empty(0), np.zeros(0, dtype=int), NO_DELAYS)


def read_activations(model: mujoco.MjModel) -> Activations:
    """Return the activations of all actuators of a model, and the controls that their delays hold back.

    A filter follows its control, so it stays within the range of the control. A muscle stays between 0 and 1.
    """
    actuators, delays = activated(model), read_delays(model)
    if not len(actuators) and not delays.size:
        return NO_ACTIVATIONS
    names: list[str] = []
    for i in dict.fromkeys(actuators.tolist()):
        name, count = f"act_{model.actuator(i).name or i + 1}", int(model.actuator_actnum[i])
        names += [name] if count == 1 else [f"{name}_{k + 1}" for k in range(count)]
    kinds = model.actuator_dyntype[actuators]
    follows = np.isin(kinds, FILTERS) & (model.actuator_ctrllimited[actuators] != 0)
    low, high = np.where(follows[:, None], model.actuator_ctrlrange[actuators], [-np.inf, np.inf]).T
    low, high = np.where(kinds == MUSCLE, 0.0, low), np.where(kinds == MUSCLE, 1.0, high)
    limited = model.actuator_actlimited[actuators, None] != 0
    least, most = np.where(limited, model.actuator_actrange[actuators], [-np.inf, np.inf]).T
    low, high = np.clip(low, least, most), np.clip(high, least, most)
    for i, count in zip(delays.actuators.tolist(), delays.counts.tolist(), strict=True):
        names += [f"ctrl_{model.actuator(i).name or i + 1}_{ago}" for ago in range(count, 0, -1)]
    held = np.repeat(delays.actuators, delays.counts)
    limited = model.actuator_ctrllimited[held, None] != 0
    least, most = np.where(limited, model.actuator_ctrlrange[held], [-np.inf, np.inf]).T
    low, high = np.concatenate([low, least]), np.concatenate([high, most])
    share = np.concatenate([np.ones(len(actuators)), np.sqrt(np.repeat(delays.counts, delays.counts))])
    width = (high - low) * share
    weights = np.divide(2.0, width, out=np.zeros_like(width), where=width > 0)
    return Activations(tuple(names), low, high, weights, np.concatenate([actuators, held]), delays)
