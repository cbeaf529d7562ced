"""What a model must not have, because it is not part of a state."""

import mujoco
import numpy as np

from planspace.errors import UsageError
from planspace.physics.activations import DYNAMICS


def check_supported(model: mujoco.MjModel) -> None:
    """Refuse a model with a hidden state, which a plan could not set or reach.

    Raises:
        UsageError: the model has one; the message names the element and a way round it.
    """
    if model.nflex:
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, 0) or "0"
        raise UsageError(
            f"the model has the flexible body {name!r}, which is not part of the state; remove "
            "it, or build it from rigid bodies."
        )
    known = np.isin(model.actuator_dyntype, list(DYNAMICS)) & (model.actuator_plugin < 0)
    unknown = np.flatnonzero((model.actuator_actnum > 0) & ~known)
    if len(unknown):
        raise UsageError(
            f"{_actuator(model, int(unknown[0]))} has an activation that planspace does not support (a "
            f'plugin, or dyntype "user", "pid" or "dcmotor"); use one of {", ".join(DYNAMICS.values())}.'
        )
    delayed = np.flatnonzero(model.actuator_delay) if model.nhistory else []
    if len(delayed):
        raise UsageError(
            f"{_actuator(model, int(delayed[0]))} has a delay, so that earlier controls are part of the "
            "state; remove its attribute delay."
        )


def _actuator(model: mujoco.MjModel, number: int) -> str:
    return f"the actuator {model.actuator(number).name or number!r}"
