"""Simulating a controller from many states until each arrives at the goal or may not go on."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.physics.simulator import Simulator
from planspace.tasks.problem import Goal


def steer(
    simulator: Simulator,
    goal: Goal,
    starts: Float[np.ndarray, "batch state"],
    control: Callable[[np.ndarray], np.ndarray],
    stride: int,
    max_s: float,
) -> tuple[Float[np.ndarray, "batch step control"], Int[np.ndarray, " batch"], Bool[np.ndarray, " batch"]]:
    """Simulate a controller from each state.

    Args:
        simulator: overwritten; at least as many simulations as starts.
        goal: where to arrive.
        starts: the first states.
        control: the controls of the simulations with these numbers, in their current states.
        stride: physics steps for which each control is held.
        max_s: time within which a simulation must arrive [s].

    Returns:
        The controls that were applied, one per physics step; the number of these steps until the goal region
        was entered or the controller gave up; and whether the goal region was entered with every state on the
        way allowed.
    """
    count = len(starts)
    ids = np.arange(count, dtype=np.int32)
    simulator.reset(starts, ids)
    num = max(1, round(max_s / (stride * simulator.model.opt.timestep)))
    controls = np.zeros((count, num, len(simulator.control_low)))
    steps = np.zeros(count, dtype=int)
    arrived = goal.reached(starts)
    moving = ~arrived
    for step in range(num):
        if not moving.any():
            break
        running = ids[moving]
        controls[running, step] = control(running)
        simulator.step(controls[running, step], stride, ids=running)
        steps[running] = (step + 1) * stride
        arrived[running] = goal.reached(simulator.states()[running])
        moving[running] = ~arrived[running] & simulator.allowed(count)[running]
    arrived = arrived & simulator.allowed(count) & ~simulator.diverged()[:count]
    return np.repeat(controls, stride, axis=1), steps, arrived
