"""The linear program of the polish: the change of all controls of a plan that brings it to its goal.

    x_k, u_k        states and controls of the plan; du_k is the change of control k
    S_kj            sensitivity of state k to control j: S_kj = A_{k-1} ... A_{j+1} B_j
    delta_k         change of state k in the linear model: delta_k = sum_j S_kj du_j
    N               the horizon: the goal is to be reached after N controls

    minimise    |x_N + delta_N - goal|_1    (plus the effort, if it is minimised)
    subject to  low <= u + du <= high,  |du| <= radius (high - low),  joint limits and clearances

Joint limits and clearances are many and rarely active. A solution is computed without them; those that it
crosses are added, and the program is solved again.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

from planspace.physics.space import StateSpace
from planspace.plan.trajectory import Trajectory
from planspace.tasks.problem import Goal

LIMIT_MARGIN = 1e-3
"""Distance to joint limits [m or rad], unless the plan itself is closer."""
CLEARANCE = 5e-3
"""Distance between geoms that must not touch [m], unless the plan itself is closer."""
EFFORT_PENALTY = 1e3
"""Cost of a unit of distance to the goal when the effort is minimised."""
MAX_CUTS = 5
"""How often a program is solved again with the limits that its solution crosses."""


class LinearModel(NamedTuple):
    """The linear model along a plan, and the distances between geoms there."""

    gains: Float[np.ndarray, "step control tangent"]
    """Feedback that keeps a simulation on the plan."""
    sensitivities: Float[np.ndarray, "time tangent variable"]
    """Change of each state per change of each control; controls are laid end to end."""
    distances: Float[np.ndarray, "time pair"]
    """Distance of each pair of geoms that must not touch [m]."""
    slopes: Float[np.ndarray, "time pair dof"]
    """Change of each distance per change of each position."""


class Limits(NamedTuple):
    """What a plan must respect, and where it must end."""

    space: StateSpace
    goal: Goal
    low: Float[np.ndarray, " control"]
    high: Float[np.ndarray, " control"]
    velocity_margin: float = 0.0
    """Distance to the bounds of velocities, as a fraction of them; if 0, programs do not see these bounds."""

    def of_states(self) -> Iterator[tuple[int, int, float, float, float]]:
        """Index in a state, index in a tangent, lower and upper bound, margin of each bounded number."""
        space = self.space
        for s, t in space.bounded:
            yield s, t, float(space.low[s]), float(space.high[s]), LIMIT_MARGIN
        if self.velocity_margin and not space.kinematic:
            for k, bound in enumerate(space.velocity_bound):
                s, t = space.num_positions + k, space.num_dofs + k
                yield s, t, -float(bound), float(bound), self.velocity_margin * float(bound)


class Change(NamedTuple):
    """The solution of a program."""

    controls: Float[np.ndarray, "step control"]
    """Change of each control up to the horizon."""
    distance: float
    """Distance to the goal at the horizon, in the linear model."""


class _Program(NamedTuple):
    """Minimise cost @ x subject to rows @ x <= limit and to bounds.

    The variables x are the changes of the controls, then for each number of a tangent the distance by which
    the end lies outside the goal's box, then for each control its size, if the effort is minimised.
    """

    cost: Float[np.ndarray, " variable"]
    rows: Float[np.ndarray, "row variable"]
    limit: Float[np.ndarray, " row"]
    bounds: Float[np.ndarray, "variable 2"]

    def solve(self) -> Float[np.ndarray, " variable"] | None:
        """The best variables, or None if the program has no solution or its linear model overflowed."""
        if not np.isfinite(self.rows).all():
            return None
        return linprog(self.cost, A_ub=self.rows, b_ub=self.limit, bounds=self.bounds, method="highs").x

    def with_rows(self, rows: np.ndarray, limit: np.ndarray) -> "_Program":
        """The program with further rows, which concern the first variables only."""
        padding = np.zeros((len(rows), self.rows.shape[1] - rows.shape[1]))
        return self._replace(
            rows=np.vstack([self.rows, np.hstack([rows, padding])]),
            limit=np.concatenate([self.limit, limit]),
        )


def solve_program(
    limits: Limits, plan: Trajectory, model: LinearModel, horizon: int, radius: float, *, effort: bool
) -> Change | None:
    """Find the change of a plan's controls that brings it nearest to the goal at a horizon.

    Args:
        limits: goal, bounds and joint limits.
        plan: the plan to change.
        model: the linear model along it.
        horizon: number of controls after which the goal is to be reached.
        radius: size of the trust region, as a fraction of each control's range.
        effort: also minimise the sizes of the controls.

    Returns:
        The change, or None if the program has no solution.
    """
    controls, n = plan.controls[:horizon], limits.space.tangent_size
    program = _reach_goal(limits, plan, model, horizon, radius)
    if effort:
        program = _with_effort(program, limits, controls)
    x = program.solve()
    for _ in range(MAX_CUTS):
        if x is None:
            return None
        rows, room = _crossed_limits(limits, plan, model, x[: controls.size])
        if not len(room):
            break
        program = program.with_rows(rows, room)
        x = program.solve()
    if x is None:
        return None
    outside = x[controls.size : controls.size + n]
    return Change(x[: controls.size].reshape(controls.shape), float(limits.goal.weights @ outside))


def _reach_goal(
    limits: Limits, plan: Trajectory, model: LinearModel, horizon: int, radius: float
) -> _Program:
    """The program without joint limits, clearances and effort."""
    goal, n, controls = limits.goal, limits.space.tangent_size, plan.controls[:horizon]
    size = controls.size
    off = limits.space.difference(plan.states[horizon], goal.center)
    end = model.sensitivities[horizon][:, :size]
    reach = radius * (limits.high - limits.low)
    low = np.maximum(limits.low - controls, -reach).ravel()
    high = np.minimum(limits.high - controls, reach).ravel()
    bounds = np.concatenate([np.column_stack([low, high]), np.tile([0.0, np.inf], (n, 1))])
    return _Program(
        cost=np.concatenate([np.zeros(size), goal.weights]),
        rows=np.vstack([np.hstack([end, -np.eye(n)]), np.hstack([-end, -np.eye(n)])]),
        limit=np.concatenate([goal.half - off, goal.half + off]),
        bounds=bounds,
    )


def _with_effort(program: _Program, limits: Limits, controls: np.ndarray) -> _Program:
    """The program with one more variable per control, its size e after the change: -e <= u + du <= e."""
    size, n = controls.size, limits.space.tangent_size
    scale = 1.0 / np.maximum(np.abs(limits.low), np.abs(limits.high))
    scaled = np.diag(np.tile(scale, len(controls)))
    sizes = np.hstack([scaled, np.zeros((size, n)), -np.eye(size)])
    negated = sizes * np.concatenate([-np.ones(size), np.ones(n), np.ones(size)])
    rows = np.hstack([program.rows, np.zeros((len(program.rows), size))])
    now = (controls * scale).ravel()
    return _Program(
        cost=np.concatenate([np.zeros(size), EFFORT_PENALTY * limits.goal.weights, np.ones(size)]),
        rows=np.vstack([rows, sizes, negated]),
        limit=np.concatenate([program.limit, -now, now]),
        bounds=np.concatenate([program.bounds, np.tile([0.0, np.inf], (size, 1))]),
    )


def _crossed_limits(
    limits: Limits, plan: Trajectory, model: LinearModel, change: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and limits for the bounds of states and the clearances that a change would cross."""
    horizon = change.size // plan.controls.shape[1]
    rows, room = [np.empty((0, change.size))], [np.empty(0)]
    for s, t, lowest, highest, margin in limits.of_states():
        sensitivity = model.sensitivities[1 : horizon + 1, t, : change.size]
        moved = sensitivity @ change
        for sign, bound in ((1.0, highest), (-1.0, lowest)):
            left = sign * (bound - plan.states[1 : horizon + 1, s])
            allowed = np.maximum(left - margin, 0.0)
            crossed = np.flatnonzero(sign * moved > allowed + 0.1 * margin)
            rows.append(sign * sensitivity[crossed])
            room.append(allowed[crossed])
    positions = model.sensitivities[: horizon + 1, : limits.space.num_dofs, : change.size]
    gained = np.einsum("kpd,kd->kp", model.slopes[: horizon + 1], positions @ change)
    allowed = np.maximum(model.distances[: horizon + 1] - CLEARANCE, 0.0)
    for k, pair in np.argwhere(-gained > allowed + 0.1 * CLEARANCE):
        rows.append(-(model.slopes[k, pair] @ positions[k])[None])
        room.append(allowed[k, pair][None])
    return np.concatenate(rows), np.concatenate(room)
