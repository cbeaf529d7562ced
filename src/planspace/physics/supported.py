"""What a model must not have, because it is not part of a state."""

import math

import mujoco
import numpy as np

from planspace.errors import UsageError
from planspace.physics.activations import DYNAMICS
from planspace.physics.delays import read_delays

RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)


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
    _check_delays(model)


def _check_delays(model: mujoco.MjModel) -> None:
    """Refuse delays with which the rounding of the time decides which control is applied."""
    for i in read_delays(model).actuators.tolist():
        delay, step = float(model.actuator_delay[i]), float(model.opt.timestep)
        (count, interpolation), wanted = model.actuator_history[i], math.ceil(delay / step - 1e-6)
        if interpolation or count != wanted or model.opt.integrator == RK4:
            raise UsageError(
                f"{_actuator(model, i)} has a delay of {delay:g} s, with which the rounding of the time "
                f'changes the steps of MuJoCo; set nsample="{wanted}", interp="zoh" and an integrator other '
                "than RK4."
            )


def _actuator(model: mujoco.MjModel, number: int) -> str:
    return f"the actuator {model.actuator(number).name or number!r}"
