"""The proof of a plan: its controls are replayed in plain MuJoCo, and the goal is held there."""

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.physics.replay import advance
from planspace.physics.simulator import Simulator
from planspace.plan.planner import Failure
from planspace.plan.query import Query
from planspace.plan.trajectory import Trajectory


def replay_plan(query: Query, controls: Float[np.ndarray, "step control"]) -> Trajectory | Failure:
    """Replay controls in plain MuJoCo from the start until they first enter the goal region.

    If the problem wants the goal held, the remaining controls and then the regulator must hold it. This is
    checked and not recorded.

    Args:
        query: start, goal and regulator.
        controls: one per physics step.

    Returns:
        One state and one control for each physics step; or a failure: the path leaves the bounds or does what
        is forbidden, never arrives, or the goal cannot be held.
    """
    space, goal, data = query.space, query.goal, mujoco.MjData(query.model)
    space.write_data(query.start, data)
    states = [np.array(query.start)]
    for control in controls:
        if goal.reached(states[-1]):
            break
        states.append(advance(query.model, data, space, control))
    path = np.stack(states)
    nearest = float(goal.distance(path).min())
    if not goal.reached(path[-1]):
        return Failure("the path does not arrive when replayed", nearest)
    if _has_warnings(data) or not _all_valid(query.simulator, path):
        return Failure("the path leaves what is valid when replayed", nearest)
    num_steps = len(path) - 1
    if query.problem.hold and not _holds(query, data, path[-1], controls[num_steps:]):
        return Failure(
            "the goal cannot be held; `hold: false` in the problem file drops this requirement", nearest
        )
    return Trajectory(path, controls[:num_steps])


def _holds(query: Query, data: mujoco.MjData, state: np.ndarray, rest: np.ndarray) -> bool:
    """Whether the remaining controls and then the regulator stay valid and end in the goal region."""
    model, space, regulator, held = query.model, query.space, query.regulator, [state]
    for control in rest:
        held.append(advance(model, data, space, control))
    stride = regulator.stride
    for _ in range(round(regulator.config.hold_s / (stride * model.opt.timestep))):
        control = regulator.control(held[-1])
        held += [advance(model, data, space, control) for _ in range(stride)]
    valid = not _has_warnings(data) and _all_valid(query.simulator, np.stack(held))
    return valid and bool(query.goal.reached(held[-1]))


def describe_unrest(query: Query) -> str:
    """Say where the robot is after the regulator tried to hold the centre of the goal; empty if it holds it.

    A plan may still be held elsewhere in the goal region, so this does not mean that there is none.
    """
    space, data = query.space, mujoco.MjData(query.model)
    space.write_data(query.goal.center, data)
    if _holds(query, data, query.goal.center, np.empty((0, len(query.regulator.hold_control)))):
        return ""
    moved = space.read_data(data) - query.goal.center
    column = int(np.argmax(np.abs(moved) * (np.arange(space.size) < space.num_positions)))
    return (
        f"after {query.regulator.config.hold_s:g} s, {space.names[column]!r} has moved by {moved[column]:.3g}"
    )


def _has_warnings(data: mujoco.MjData) -> bool:
    return any(w.number for w in data.warning)


def _all_valid(simulator: Simulator, states: np.ndarray) -> bool:
    size = simulator.num
    parts = [states[i : i + size] for i in range(0, len(states), size)]
    return all(simulator.valid_states(part).all() for part in parts)
