"""Dynamics linearised by finite differences in batched simulation, in the tangent space of the states.

(`mjd_transitionFD` does not support the Runge-Kutta integrator that many models use.)

    A_k = d x_{k+1} / d x_k,    B_k = d x_{k+1} / d u_k
"""

import contextlib
from dataclasses import replace

import mujoco
import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import lsq_linear

from planspace.physics.activations import INTEGRATOR
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.tasks.problem import Goal

NUDGE = 1e-6
"""Half of the width of the differences. At a bound, where MuJoCo clips them, controls and activations are
moved only inwards."""
EQUILIBRIUM_ITERATIONS = 5


def along(
    simulator: Simulator,
    states: Float[np.ndarray, "step state"],
    controls: Float[np.ndarray, "step control"],
    num_steps: int = 1,
) -> tuple[Float[np.ndarray, "step tangent tangent"], Float[np.ndarray, "step tangent control"]]:
    """Linearise at each state and control.

    Args:
        simulator: any number of simulations; overwritten.
        states: the states.
        controls: the control in each state.
        num_steps: physics steps for which each control is held.

    Returns:
        A and B for each state.
    """
    space, count = simulator.space, len(states)
    n, m = space.tangent_size, controls.shape[1]
    nudges = np.concatenate([np.eye(n + m), -np.eye(n + m)]) * NUDGE
    starts = _within_limits(space, states, space.integrate(states[:, None], nudges[None, :, :n]))
    held = np.clip(controls[:, None] + nudges[None, :, n:], simulator.control_low, simulator.control_high)
    ends = step_all(simulator, starts.reshape(-1, space.size), held.reshape(-1, m), num_steps)
    ends = ends.reshape(count, 2, n + m, space.size)
    change = space.difference(ends[:, 0], ends[:, 1])
    width = np.full((count, n), 2 * NUDGE)
    k = space.num_activations
    moved = starts.reshape(count, 2, n + m, space.size)[:, :, n - k : n, space.size - k :]
    width[:, n - k :] = np.einsum("kii->ki", moved[:, 0] - moved[:, 1])  # half as wide at a limit
    state_part = change[:, :n] / np.maximum(width, 0.5 * NUDGE)[..., None]
    applied = held.reshape(count, 2, n + m, m)[:, :, n:]
    width = np.einsum("kii->ki", applied[:, 0] - applied[:, 1])  # half as wide at a bound
    control_part = change[:, n:] / np.maximum(width, 0.5 * NUDGE)[..., None]
    return state_part.transpose(0, 2, 1), control_part.transpose(0, 2, 1)


def _within_limits(space: StateSpace, states: np.ndarray, nudged: np.ndarray) -> np.ndarray:
    """The nudged states with activations moved only inwards at a limit, where MuJoCo clips them."""
    first = space.velocities.stop
    now = states[:, None, first:]
    low, high = np.minimum(space.activations.low, now), np.maximum(space.activations.high, now)
    nudged[..., first:] = np.clip(nudged[..., first:], low, high)
    return nudged


def sensitivities(
    a: Float[np.ndarray, "step tangent tangent"], b: Float[np.ndarray, "step tangent control"]
) -> Float[np.ndarray, "time tangent variable"]:
    """Change of each state of a trajectory per change of each of its controls, laid end to end.

    Along an unstable motion they grow with every step and may overflow: then they are not finite.
    """
    count, n, m = b.shape
    sensitivity = np.zeros((count + 1, n, count * m))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(count):
            sensitivity[k + 1, :, : k * m] = a[k] @ sensitivity[k, :, : k * m]
            sensitivity[k + 1, :, k * m : (k + 1) * m] = b[k]
    return sensitivity


def time_varying_lqr(
    a: Float[np.ndarray, "step tangent tangent"],
    b: Float[np.ndarray, "step tangent control"],
    state_cost: Float[np.ndarray, " tangent"],
    control_cost: Float[np.ndarray, " control"],
    following: Int[np.ndarray, " step"] | None = None,
    end_repeats: int = 1,
) -> tuple[Float[np.ndarray, "step control tangent"], Float[np.ndarray, "step tangent tangent"]]:
    """A time-varying LQR that keeps a simulation on one or several trajectories.

    Where the linear model has no solution, for example because it overflows, the gain is zero.

    Args:
        a: change of the next state per change of each state.
        b: change of the next state per change of each control.
        state_cost: cost of the square of each number of a tangent.
        control_cost: cost of the square of each control.
        following: the step, a later one, that follows each; -1 where a trajectory ends. By default the steps
            are one trajectory in order.
        end_repeats: how often the last step of a trajectory is taken. With many, its gain holds the end.

    Returns:
        The gain of each step, and the matrix of the cost to go from its beginning.
    """
    count, n, m = b.shape
    if following is None:
        following = np.append(np.arange(1, count), -1)
    gains, values = np.zeros((count, m, n)), np.zeros((count, n, n))
    for k in reversed(range(count)):
        is_end = following[k] < 0
        value = np.diag(state_cost) if is_end else values[following[k]]
        for _ in range(end_repeats if is_end else 1):
            gains[k], value = _riccati_step(a[k], b[k], value, state_cost, control_cost)
        values[k] = value
    return gains, values


def _riccati_step(
    a: np.ndarray, b: np.ndarray, value: np.ndarray, state_cost: np.ndarray, control_cost: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The gain of a step, zero without a solution, and the value before it, anew where it overflows."""
    cost, gain = np.diag(state_cost), np.zeros(b.T.shape)
    with np.errstate(over="ignore", invalid="ignore"):
        pull = b.T @ value
        with contextlib.suppress(np.linalg.LinAlgError):
            found = np.linalg.solve(np.diag(control_cost) + pull @ b, pull @ a)
            gain = np.where(np.isfinite(found).all(), found, gain)
        before = cost + a.T @ value @ (a - b @ gain)
    return gain, before if np.isfinite(before).all() else cost


def equilibrium_control(
    simulator: Simulator, state: Float[np.ndarray, " state"]
) -> Float[np.ndarray, " control"]:
    """The control within bounds under which a state changes least (Gauss-Newton).

    The search starts at the control at which actuators exert no force. For a servo that is its target at the
    state; at any other target it may be saturated, where its force has no slope.
    """
    low, high = simulator.control_low, simulator.control_high
    control = forceless_control(simulator, state)
    for _ in range(EQUILIBRIUM_ITERATIONS):
        _, b = along(simulator, state[None], control[None])
        moved = simulator.space.difference(step_all(simulator, state[None], control[None], 1)[0], state)
        change = np.linalg.lstsq(b[0], -moved, rcond=1e-9)[0]
        control = np.clip(control + change, low, high)
    return control


def at_rest(simulator: Simulator, goal: Goal) -> Goal:
    """The goal with the activations at its centre under which the state changes least.

    Only activations that are free in the goal are changed. They are found together with the control, by
    Gauss-Newton steps within the bounds of both.

    Args:
        simulator: any number of simulations; overwritten.
        goal: the goal.
    """
    space = simulator.space
    first = space.tangent_velocities.stop
    free = np.flatnonzero(goal.weights[first:] == 0)
    if not len(free):
        return goal
    states, tangents = space.velocities.stop + free, first + free
    low = np.concatenate([space.activations.low[free], simulator.control_low])
    high = np.concatenate([space.activations.high[free], simulator.control_high])
    center, inputs = goal.center.copy(), _forceless_inputs(simulator, goal.center)
    found = np.concatenate(
        [inputs[space.activations.actuators[free]], forceless_control(simulator, goal.center)]
    )
    found = np.clip(found, low, high)
    for _ in range(EQUILIBRIUM_ITERATIONS):
        center[states], control = np.split(found, [len(free)])
        a, b = along(simulator, center[None], control[None])
        moved = space.difference(step_all(simulator, center[None], control[None], 1)[0], center)
        slopes = np.hstack([(a[0] - np.eye(space.tangent_size))[:, tangents], b[0]])
        change = lsq_linear(slopes, -moved, bounds=(low - found, high - found), method="bvls").x
        found = np.clip(found + change, low, high)
    center[states] = found[: len(free)]
    return replace(goal, center=center)


def forceless_control(
    simulator: Simulator, state: Float[np.ndarray, " state"]
) -> Float[np.ndarray, " control"]:
    """The control within bounds at which each actuator exerts no force in a state; 0 for a motor.

    A filter would have settled at this control. An integrator gets 0, at which its activation stays.
    """
    low, high = simulator.control_low, simulator.control_high
    if simulator.space.kinematic:
        return np.clip(np.zeros(len(low)), low, high)
    integrates = simulator.model.actuator_dyntype == INTEGRATOR
    return np.clip(np.where(integrates, 0.0, _forceless_inputs(simulator, state)), low, high)


def _forceless_inputs(simulator: Simulator, state: np.ndarray) -> np.ndarray:
    """The input of each actuator's force, its activation or else its control, at which it exerts none."""
    simulator.reset(state[None], np.zeros(1, dtype=np.int32))
    data, model = simulator.mujoco_data(0), simulator.model
    length, speed = data.actuator_length, data.actuator_velocity
    gain, bias = (_affine(terms, length, speed) for terms in (model.actuator_gainprm, model.actuator_biasprm))
    has_bias = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    usable = has_bias & (model.actuator_gaintype <= int(mujoco.mjtGain.mjGAIN_AFFINE)) & (gain != 0)
    return np.where(usable, -bias / np.where(usable, gain, 1.0), 0.0)


def _affine(terms: np.ndarray, length: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """The terms of MuJoCo's affine gains and biases: constant, length, velocity."""
    return terms[:, 0] + terms[:, 1] * length + terms[:, 2] * speed


def step_all(simulator: Simulator, starts: np.ndarray, controls: np.ndarray, num_steps: int) -> np.ndarray:
    """Apply one control from each start, in batches of the simulator's size."""
    ends = np.empty_like(starts)
    for first in range(0, len(starts), simulator.num):
        part = slice(first, min(first + simulator.num, len(starts)))
        ids = np.arange(part.stop - first, dtype=np.int32)
        simulator.reset(starts[part], ids)
        simulator.step(controls[part], num_steps, ids=ids)
        ends[part] = simulator.states()[: len(ids)]
    return ends
