"""One simulation in plain MuJoCo: the loop against which the batched simulator is checked."""

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.errors import PlanspaceError
from planspace.mjcf.compile import stepping
from planspace.physics.space import StateSpace
from planspace.physics.step_count import count_steps

MAX_REPEATS = 100_000
"""Largest number of steps between two recorded states."""


def advance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    space: StateSpace,
    control: Float[np.ndarray, " control"],
    num_steps: int = 1,
) -> Float[np.ndarray, " state"]:
    """Apply a control for a number of steps and return the state after them."""
    count_steps(num_steps)
    if space.kinematic:
        before = space.read_data(data)
        space.write_data(space.integrate(before, control * num_steps * model.opt.timestep), data)
    else:
        data.ctrl[:] = control
        with stepping():
            mujoco.mj_step(model, data, nstep=num_steps)
    return space.read_data(data)


def replay(
    model: mujoco.MjModel,
    space: StateSpace,
    start: Float[np.ndarray, " state"],
    controls: Float[np.ndarray, "step control"],
    times: Float[np.ndarray, " time"],
) -> Float[np.ndarray, "time state"]:
    """Simulate recorded controls.

    Args:
        model: the compiled model; its time step is restored afterwards.
        space: state space of the model.
        start: the first state.
        controls: the control between each time and the next.
        times: time of each state [s]. An interval that is not a multiple of the model's time step is
            simulated as one step of that length.

    Returns:
        The state at each time.

    Raises:
        PlanspaceError: an interval has more than `MAX_REPEATS` steps, or MuJoCo fails.
    """
    data = mujoco.MjData(model)
    space.write_data(start, data)
    states = [np.array(start, dtype=float)]
    own_step = model.opt.timestep
    try:
        for control, interval in zip(controls, np.diff(times), strict=True):
            if not interval <= MAX_REPEATS * own_step:
                raise PlanspaceError(
                    f"two states are {interval:.3g} s apart, more than {MAX_REPEATS} steps of the model."
                )
            repeats = round(interval / own_step)
            whole = repeats >= 1 and abs(interval - repeats * own_step) < 1e-3 * own_step
            model.opt.timestep = own_step if whole else interval
            states.append(advance(model, data, space, control, repeats if whole else 1))
    finally:
        model.opt.timestep = own_step
    return np.stack(states)
