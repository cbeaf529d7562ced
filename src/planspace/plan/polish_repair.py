"""Repair of a path that does not reach its goal: the states jump first, and the jumps are then closed.

A path of the planner is continued to the goal on a straight line, or around obstacles (`polish_route`), which
no control can follow. States and controls are then changed together until each state follows from the one
before (multiple shooting, by sequential linear programming):

    x_k, u_k        states and controls of the guess; dx_k and du_k are their changes
    d_k             jump: the state after x_k and u_k, minus x_{k+1}
    w               weights of the states

    minimise    sum_k w |d_k + A_k dx_k + B_k du_k - dx_{k+1}| + PENALTY (overlap of geoms)
    subject to  bounds of states and controls,  w |dx| <= radius,  |du| <= radius (high - low),
                dx_0 = 0,  dx_N within the goal region

Source: sequential convex programming with slack (Schulman et al. 2014); closing the jumps of a search by
optimisation is the idea of iDb-A* (Ortiz-Haro et al. 2023).
"""

import copy
from typing import Any, NamedTuple

import mujoco
import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.optimize import linprog

from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan import linearise
from planspace.plan.polish_program import CLEARANCE, Limits
from planspace.plan.polish_rollout import Rollout
from planspace.plan.polish_route import Route
from planspace.plan.trajectory import Trajectory

MAX_KNOTS = 200
"""Longer guesses are repaired in longer steps."""
LONGER = 1.5
"""Jumps may become longer than the longest at first by this factor."""
PENALTY = 10.0
"""Cost of an overlap [1/m]."""
CLOSED, EXACT = 1e-3, 1e-6
"""A guess is repaired if no weighted jump is longer than the first; the programs end at the second."""
FIRST_RADIUS = 0.5
SMALLEST_RADIUS = 2e-3
LEAST_GAIN = 1e-2
"""The repair ends if a program promises less than this fraction of what is left."""
JUMP_S = 0.5
"""Least duration of the straight line to the goal [s]."""
SPEED = 0.5
"""Fraction of the velocity bounds at which the straight line is followed, if that takes longer."""

MAX_PIVOTS = 3_000
"""Iterations of a method for linear programs."""
ITERATION_LIMIT = 1
"""Status of `linprog` where the iterations did not suffice."""
LINE_POINTS = 12
"""Points of a straight line at which overlaps are measured."""
STRETCHES = (1.0, 2.0, 4.0, 8.0)
"""The straight line takes this many times as long; the next is tried if the jumps cannot be closed."""


class _Merit(NamedTuple):
    """How far a guess is from a plan."""

    jumps: Float[np.ndarray, "step tangent"]
    distances: Float[np.ndarray, "time pair"]
    total: float


class Repair:
    """Closes the jumps of guesses for one goal."""

    def __init__(self, rollout: Rollout, limits: Limits, iterations: int):
        """Prepare the repair.

        Args:
            rollout: simulations, whose `stride` is the duration of a knot.
            limits: bounds and goal.
            iterations: largest number of linear programs.
        """
        self.rollout, self.limits, self.iterations = rollout, limits, iterations
        self.weights = np.sqrt(rollout.state_cost)
        self.low, self.high = self._state_bounds()

    def run(self, guess: Trajectory) -> Trajectory | None:
        """A guess with closed jumps, simulated with feedback; None if jumps or overlaps remain."""
        radius, now = FIRST_RADIUS, self._merit(guess)
        longest = LONGER * self._longest(now)  # no jump may become a leap through an obstacle
        for _ in range(self.iterations):
            if not np.isfinite(now.total) or self._longest(now) < EXACT:
                break
            linear = self._linear(guess)
            if not all(np.isfinite(part).all() for part in linear):
                break
            better, radius = self._improved(guess, now, linear, radius, max(longest, self._longest(now)))
            if better is None:
                break
            guess, now = better
        closed = self._longest(now) < CLOSED and now.distances.min(initial=1.0) > 0.0
        return self.rollout.followed(guess) if closed else None

    def _improved(
        self,
        guess: Trajectory,
        now: _Merit,
        linear: tuple[np.ndarray, np.ndarray],
        radius: float,
        longest: float,
    ) -> tuple[tuple[Trajectory, _Merit] | None, float]:
        """A better guess, or None if no trust region has one; and the trust region for the next."""
        while radius > SMALLEST_RADIUS:
            found = self._solve(guess, now, linear, radius, longest)
            if found is None or now.total - found[1] < LEAST_GAIN * now.total:
                break
            changed, promised = found
            then = self._merit(changed)
            gained = (now.total - then.total) / (now.total - promised)
            radius *= 2.0 if gained > 0.75 else 1.0 if gained > 0.25 else 0.3
            if gained > 0.1:
                return (changed, then), radius
        return None, radius

    def _longest(self, now: _Merit) -> float:
        return float((self.weights * np.abs(now.jumps)).max())

    def _state_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of each number of a tangent, relative to a state of zeros; infinite for rotations."""
        size = self.limits.space.tangent_size
        low, high = np.full(size, -np.inf), np.full(size, np.inf)
        for _, t, least, most, margin in self.limits.of_states():
            low[t], high[t] = least + margin, most - margin
        return low, high

    def _linear(self, guess: Trajectory) -> tuple[np.ndarray, np.ndarray]:
        return linearise.along(self.rollout.simulator, guess.states[:-1], guess.controls, self.rollout.stride)

    def _merit(self, guess: Trajectory) -> _Merit:
        """The jumps of a guess and the distances between its geoms, and what both cost."""
        ends = linearise.step_all(
            self.rollout.simulator, guess.states[:-1], guess.controls, self.rollout.stride
        )
        jumps = self.limits.space.difference(ends, guess.states[1:])
        clearance = self.rollout.clearance
        distances = (
            np.empty((len(guess.states), 0)) if clearance is None else clearance.distances(guess.states)
        )
        overlap = np.maximum(2 * CLEARANCE - distances, 0.0).sum()
        return _Merit(jumps, distances, float((self.weights * np.abs(jumps)).sum() + PENALTY * overlap))

    def _solve(
        self,
        guess: Trajectory,
        now: _Merit,
        linear: tuple[np.ndarray, np.ndarray],
        radius: float,
        longest: float,
    ) -> tuple[Trajectory, float] | None:
        """The changed guess and the cost that the linear model promises."""
        (a, b), (count, n, m) = linear, linear[1].shape
        rows, room = self._overlaps(guess, now)
        last = sp.identity(count * n, format="csr")
        before = sp.block_diag([*a[1:]], format="csr") if count > 1 else sp.csr_matrix((0, 0))
        shifted = sp.bmat(
            [[sp.csr_matrix((n, (count - 1) * n)), None], [before, sp.csr_matrix(((count - 1) * n, n))]]
        )
        dynamics = sp.hstack([last - shifted, -sp.block_diag([*b]), -last, last], format="csr")
        jumps, overlaps = now.jumps.ravel(), len(room)
        equal = sp.hstack([dynamics, sp.csr_matrix((count * n, overlaps))], format="csr")
        above = sp.hstack([rows, sp.csr_matrix((overlaps, count * (m + 2 * n))), -sp.identity(overlaps)])
        weights = np.tile(self.weights, count)
        cost = np.concatenate([np.zeros(count * (n + m)), weights, weights, np.full(overlaps, PENALTY)])
        most = np.concatenate([longest / np.maximum(weights, 1e-6)] * 2 + [np.full(overlaps, np.inf)])
        slack = np.column_stack([np.zeros_like(most), most])
        bounds = np.concatenate([*self._bounds(guess, radius), slack])
        more = {"A_ub": above.tocsr(), "b_ub": room} if overlaps else {}
        x = minimum(cost, A_eq=equal, b_eq=jumps, bounds=bounds, **more)
        if x is None:
            return None
        dx = np.concatenate([np.zeros((1, n)), x[: count * n].reshape(count, n)])
        du = x[count * n : count * (n + m)].reshape(count, m)
        states = self.limits.space.integrate(guess.states, dx)
        return Trajectory(states, guess.controls + du), float(cost @ x)

    def _bounds(self, guess: Trajectory, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the changes of states 1 to N and of all controls."""
        limits, goal, n = self.limits, self.limits.goal, self.limits.space.tangent_size
        at = np.zeros((len(guess.states) - 1, n))
        for s, t, *_ in limits.of_states():
            at[:, t] = guess.states[1:, s]
        reach = radius / np.maximum(self.weights, 1e-6)
        low = np.clip(self.low - at, -reach, reach)
        high = np.clip(self.high - at, -reach, reach)
        allowed = 0.5 * goal.tolerance / np.maximum(n * goal.weights, 1e-9)
        off = limits.space.difference(guess.states[-1], goal.center)
        low[-1], high[-1] = (
            np.clip(sign * (allowed + goal.half) - off, low[-1], high[-1]) for sign in (-1, 1)
        )
        free = radius * (limits.high - limits.low)
        lowest = np.maximum(limits.low - guess.controls, -free)
        highest = np.minimum(limits.high - guess.controls, free)
        return (
            np.column_stack([low.ravel(), high.ravel()]),
            np.column_stack([lowest.ravel(), highest.ravel()]),
        )

    def _overlaps(self, guess: Trajectory, now: _Merit) -> tuple[sp.csr_matrix, np.ndarray]:
        """Rows and limits: distance + slope dx >= twice the clearance, for geoms that are near."""
        clearance, n = self.rollout.clearance, self.limits.space.tangent_size
        columns = (len(guess.states) - 1) * n
        if clearance is None:
            return sp.csr_matrix((0, columns)), np.empty(0)
        slopes = clearance.slopes(guess.states, now.distances)
        times, pairs = np.nonzero(np.abs(slopes).max(axis=2) > 0)
        times, pairs = times[times > 0], pairs[times > 0]
        dofs = slopes.shape[2]
        number = np.repeat(np.arange(len(times)), dofs)
        column = ((times - 1) * n)[:, None] + np.arange(dofs)
        values = -slopes[times, pairs]
        rows = sp.csr_matrix((values.ravel(), (number, column.ravel())), (len(times), columns))
        return rows, now.distances[times, pairs] - 2 * CLEARANCE


def minimum(cost: np.ndarray, **program: Any) -> np.ndarray | None:
    """The variables that minimise a linear program given as to `linprog`; None if none are found.

    The simplex method is exact and quick on most programs, but a few, of long plans of arms with six or
    seven joints, take it minutes. After MAX_PIVOTS, the interior-point method takes over, without presolve,
    which misleads it on such programs.
    """
    found = linprog(cost, method="highs", options={"maxiter": MAX_PIVOTS}, **program)
    if found.status == ITERATION_LIMIT:
        options = {"maxiter": MAX_PIVOTS, "presolve": False}
        found = linprog(cost, method="highs-ipm", options=options, **program)
    return found.x if found.success else None


def continued_to_goal(
    rollout: Rollout, limits: Limits, path: Trajectory, stretch: float
) -> Trajectory | None:
    """A path up to where it is nearest to the goal, and from there a straight line to the goal.

    If geoms overlap on each straight line, a way around them from the start of the path; None if there is
    none. Controls hold the goal.
    """
    space, center = limits.space, limits.goal.center
    weights = np.sqrt(rollout.state_cost)
    away, overlaps = np.abs(space.difference(path.states, center)) @ weights, _overlaps(rollout, limits, path)
    end = int(np.where(overlaps > overlaps.min(), np.inf, away).argmin())
    corners: np.ndarray | None = np.stack([path.states[end], center])
    if rollout.clearance is not None and overlaps[end] > 0.0:
        end, corners = 0, Route(rollout.clearance, space, weights).find(path.states[0], center)
    if corners is None:
        return None
    line = _timed(rollout, space, corners, stretch)
    held = linearise.equilibrium_control(rollout.simulator, center)
    controls = np.concatenate([path.controls[:end], np.tile(held, (len(line), 1))])
    return Trajectory(np.concatenate([path.states[: end + 1], line]), controls)


def _timed(rollout: Rollout, space: StateSpace, corners: np.ndarray, stretch: float) -> np.ndarray:
    """States in equal steps of time on a line of several parts, without the first."""
    ways = space.difference(corners[1:], corners[:-1])
    slow = np.abs(ways[:, : space.num_dofs]) / (SPEED * space.velocity_bound)
    ends = np.cumsum(np.maximum(slow.max(axis=1), 1e-3))
    dt = rollout.stride * rollout.simulator.model.opt.timestep
    count = max(2, round(stretch * max(JUMP_S, float(ends[-1])) / dt))
    at = np.arange(1, count + 1) / count * ends[-1]
    part = np.minimum(np.searchsorted(ends, at), len(ends) - 1)
    began = np.concatenate([[0.0], ends])[part]
    return space.integrate(corners[part], ((at - began) / (ends[part] - began))[:, None] * ways[part])


def without_contacts(simulator: Simulator) -> Simulator:
    """Simulations in which geoms pass through each other, for guesses whose geoms still overlap."""
    model = copy.copy(simulator.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return Simulator(model, simulator.space, simulator.num, threads=simulator.threads)


def _overlaps(rollout: Rollout, limits: Limits, path: Trajectory) -> np.ndarray:
    """The largest overlap on a straight line from each state of a path to the goal [m]."""
    if rollout.clearance is None:
        return np.zeros(len(path.states))
    fractions = np.linspace(0.0, 1.0, LINE_POINTS)
    lines = [limits.space.interpolate(state, limits.goal.center, fractions) for state in path.states]
    nearest = rollout.clearance.distances(np.concatenate(lines)).min(axis=1, initial=1.0)
    return np.maximum(-nearest.reshape(len(path.states), LINE_POINTS).min(axis=1), 0.0)
