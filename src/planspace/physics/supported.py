"""What a model must not have, because it is not part of a state."""

import mujoco
import numpy as np

from planspace.errors import UsageError


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
    if model.na:
        number = int(np.flatnonzero(model.actuator_dyntype != int(mujoco.mjtDyn.mjDYN_NONE))[0])
        raise UsageError(
            f"{_actuator(model, number)} has an activation (a filter or a muscle), which is not part of the "
            'state; replace it by a <motor>, a <position> or a <general dyntype="none">.'
        )
    delayed = np.flatnonzero(model.actuator_delay) if model.nhistory else []
    if len(delayed):
        raise UsageError(
            f"{_actuator(model, int(delayed[0]))} has a delay, so that earlier controls are part of the "
            "state; remove its attribute delay."
        )


def _actuator(model: mujoco.MjModel, number: int) -> str:
    return f"the actuator {model.actuator(number).name or number!r}"
