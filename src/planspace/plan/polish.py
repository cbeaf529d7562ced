"""Makes a plan short: sequential linear programming over its controls, simulated in closed loop.

A plan from a random tree wanders. Here its dynamics are linearised along it; a linear program finds the
change of all controls at once, within their bounds, the joints' limits and a trust region, after which the
state at an earlier horizon lies in the goal region. The change is simulated at several shares of its size,
with feedback towards the states the linear model promises: without it an unstable plant (a pole, an acrobot)
leaves the linear model's reach within a few steps. The horizon shrinks until no program finds a shorter plan.

    delta_k = sum_j S_kj du_j    where S_kj = A_{k-1} ... A_{j+1} B_j
    minimise |x_N + delta_N - goal|_1  (or the effort)  subject to  low <= u + du <= high,  |du| <= radius

Rejected: iterative LQR with a terminal cost (lands, but has no notion of the shortest horizon); shortcuts
between states of the plan (two states of an underactuated plant can rarely be joined by a shorter edge).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

from planspace.physics.simulator import Simulator
from planspace.plan import linearise
from planspace.plan.clearance import Clearance
from planspace.plan.config import PolishConfig
from planspace.plan.trajectory import Trajectory
from planspace.tasks.problem import Goal

SHARES = np.array([1.0, 0.6, 0.35, 0.2, 0.1, 0.05, 0.02, 0.005])
"""Shares of a change that are simulated side by side."""
SHORTEST = 0.7
"""A horizon is shortened to no less than this share at once."""
LIMIT_MARGIN = 1e-3
"""Keeps this far from joint limits [m or rad], where the plan itself does."""
CLEARANCE = 5e-3
"""Keeps this far from what must not be touched [m], where the plan itself does."""
EFFORT_PENALTY = 1e3
"""What a unit of distance to the goal costs when the effort is minimised."""
MAX_CUTS = 5
"""A program is solved again with the limits its solution crosses, at most so many times."""
RADII = (0.03, 0.1, 0.3, 1.0)
"""Shares of the trust region in which a program is tried, the smallest first."""
GENTLE = 0.25
"""It has reached the goal when it promises to come within this share of the tolerance."""
WIDER = 4.0
"""The trust region becomes so much wider after a change that was right as a whole."""
LEAST_TRUST = 0.3
"""The trust region becomes at most so much smaller at once ..."""
SMALLEST_RADIUS = 1e-3
"""... and never smaller than this share of a control's range."""
PATIENCE = 4
"""An aim is given up after so many changes that brought little (one that brought nothing counts twice)."""


class _Model(NamedTuple):
    """A trajectory's linear model: gains, sensitivities, and how far apart things are along it."""

    gains: Float[np.ndarray, "step control tangent"]
    answers: Float[np.ndarray, "time tangent variable"]
    distances: Float[np.ndarray, "time pair"]
    slopes: Float[np.ndarray, "time pair dof"]


class Polish:
    """Polishes plans to one goal."""

    def __init__(
        self,
        simulator: Simulator,
        goal: Goal,
        weights: Float[np.ndarray, " tangent"],
        config: PolishConfig,
        *,
        clearance: Clearance | None = None,
        effort: bool = False,
    ):
        """Prepares it.

        Args:
            simulator: at least 8 simulations; overwritten.
            goal: where plans are to end.
            weights: how much each number of a tangent counts in the feedback.
            config: the other settings.
            clearance: measures what must not touch; without it, contacts are only checked.
            effort: minimise the controls' effort at the plan's duration, instead of the duration.
        """
        self.simulator, self.goal, self.config, self.effort = simulator, goal, config, effort
        self.space, self.clearance = simulator.space, clearance
        self._low, self._high = simulator.control_low, simulator.control_high
        self._state_cost = np.asarray(weights, dtype=float) ** 2
        self._control_cost = config.tracking_cost / (0.5 * (self._high - self._low)) ** 2
        self._stride, self._left = 1, 0
        self._radius = 1.0  # of the trust region, as a share of each control's range

    def run(
        self, start: Float[np.ndarray, " state"], controls: Float[np.ndarray, "step control"]
    ) -> Float[np.ndarray, "shorter control"] | None:
        """Lands a plan in the goal region, then makes it as short, or as light, as it can.

        Args:
            start: where it starts.
            controls: one a physics step; it need not reach the goal.

        Returns:
            The controls of the best plan found, one a physics step; None if none reaches the goal.
        """
        if len(controls) == 0:
            return None
        self._stride = -(-len(controls) // self.config.max_blocks)
        self._left, self._radius = self.config.max_iterations, 1.0
        blocks = np.array_split(controls, np.arange(self._stride, len(controls), self._stride))
        guess = np.stack([block.mean(axis=0) for block in blocks])
        best = self._land(self._follow(start, controls, guess))
        if best is None:
            return None
        best = self._lighten(best) if self.effort else self._shorten(best)
        return np.repeat(best.controls, self._stride, axis=0)

    # --- landing and shortening -------------------------------------------------------------------------

    def _land(self, plan: Trajectory) -> Trajectory | None:
        landed = self._cut(plan)
        return landed if landed is not None else self._aim(plan, len(plan.controls), self._model(plan))

    def _shorten(self, best: Trajectory) -> Trajectory:
        while self._left > 0 and len(best.controls) > 1:
            length, model = len(best.controls), self._model(best)
            horizon = self._reachable(best, model)
            shorter = self._aim(best, horizon, model)
            while shorter is None and horizon < length - 1:
                horizon, self._radius = max(horizon + 1, (horizon + length) // 2), 1.0
                shorter = self._aim(best, min(horizon, length - 1), model)
            if shorter is None:
                return best
            best = shorter
        return best

    def _lighten(self, best: Trajectory) -> Trajectory:
        """Minimises the effort at a fixed duration."""
        misses, model = 0, self._model(best)
        while self._left > 0 and misses < PATIENCE:
            lighter = self._change(best, len(best.controls), model, effort=True)
            valid = [self._cut(plan) for _, plan in lighter]
            valid = [plan for plan in valid if plan is not None and self._spent(plan) < self._spent(best)]
            if valid:
                best, misses = min(valid, key=self._spent), 0
                model = self._model(best)
            else:
                misses += 1
                self._trust(0.0)
        return best

    def _spent(self, plan: Trajectory) -> float:
        return float(np.abs(plan.controls / np.maximum(np.abs(self._low), np.abs(self._high))).sum())

    def _reachable(self, plan: Trajectory, model: _Model) -> int:
        """The shortest horizon at which the linear model reaches the goal within the trust region."""
        low, high = max(1, int(SHORTEST * len(plan.controls))), len(plan.controls) - 1
        while low < high:
            middle = (low + high) // 2
            found = self._program(plan, model, middle, effort=False)
            if found is not None and found[1] <= 0.5 * self.goal.tolerance:
                high = middle
            else:
                low = middle + 1
        return high

    def _aim(self, plan: Trajectory, horizon: int, model: _Model) -> Trajectory | None:
        """Changes a plan until it reaches the goal by the horizon; None when that gets nowhere."""
        stalled = 0
        before = float(self.goal.distance(plan.states[horizon]))
        while self._left > 0 and stalled < PATIENCE:
            tried = self._change(plan, horizon, model, effort=False)
            landed = [(share, self._cut(each)) for share, each in tried]
            found = [(len(each.controls), share, each) for share, each in landed if each is not None]
            if found:
                _, share, shorter = min(found, key=lambda each: each[0])
                self._trust(share)
                return shorter
            ends = [float(self.goal.distance(each.states[-1])) for _, each in tried]
            if ends and min(ends) < before - 1e-3:
                share, plan = tried[int(np.argmin(ends))]
                stalled = stalled + 1 if min(ends) > 0.9 * before else 0
                before, model = min(ends), self._model(plan)
                self._trust(share)
            else:
                stalled += 2
                self._trust(0.0)
        return None

    def _trust(self, share: float) -> None:
        """Widens the trust region after a change that was right as a whole, else narrows it."""
        factor = WIDER if share == 1.0 else max(share, LEAST_TRUST)
        self._radius = float(np.clip(factor * self._radius, SMALLEST_RADIUS, 1.0))

    def _cut(self, plan: Trajectory) -> Trajectory | None:
        """The plan up to where it first enters the goal region, if it does."""
        inside = self.goal.distance(plan.states) <= self.config.landing * self.goal.tolerance
        if not inside.any():
            return None
        end = int(inside.argmax())
        return Trajectory(plan.states[: end + 1], plan.controls[:end])

    # --- one change -------------------------------------------------------------------------------------

    def _change(
        self, plan: Trajectory, horizon: int, model: _Model, *, effort: bool
    ) -> list[tuple[float, Trajectory]]:
        """The allowed ones of the trajectories that shares of the program's change lead to."""
        self._left -= 1
        found = self._gentlest(plan, model, horizon, effort=effort)
        if found is None:
            return []
        change = found[0]
        promised = np.einsum("kij,j->ki", model.answers[: horizon + 1, :, : change.size], change.ravel())
        states, controls, allowed = self._closed_loop(plan, model.gains, change, promised)
        kept = np.flatnonzero(allowed)
        return [(float(SHARES[i]), Trajectory(states[i], controls[i])) for i in kept]

    def _gentlest(
        self, plan: Trajectory, model: _Model, horizon: int, *, effort: bool
    ) -> tuple[np.ndarray, float] | None:
        """The program in the smallest trust region in which it reaches the goal.

        A linear program that can reach it in many ways picks a corner, with every control at the edge of its
        region: the smaller that is, the better the linear model holds.
        """
        widest, found = self._radius, None
        for share in (1.0,) if effort else RADII:
            self._radius = share * widest
            found = self._program(plan, model, horizon, effort=effort) or found
            if found is not None and found[1] <= GENTLE * self.goal.tolerance:
                break
        return found

    def _model(self, plan: Trajectory) -> _Model:
        a, b = linearise.along(self.simulator, plan.states[:-1], plan.controls, self._stride)
        gains = linearise.tracking_gains(a, b, self._state_cost, self._control_cost)
        if self.clearance is None:
            none = np.empty((len(plan.states), 0))
            return _Model(gains, linearise.sensitivities(a, b), none, none[..., None])
        distances = self.clearance.distances(plan.states)
        slopes = self.clearance.slopes(plan.states, distances)
        return _Model(gains, linearise.sensitivities(a, b), distances, slopes)

    def _program(
        self, plan: Trajectory, model: _Model, horizon: int, *, effort: bool
    ) -> tuple[np.ndarray, float] | None:
        """The linear program: the change of the controls up to the horizon and the distance it promises."""
        n, controls = self.space.tangent_size, plan.controls[:horizon]
        size = controls.size
        off = self.space.difference(plan.states[horizon], self.goal.center)
        end = model.answers[horizon][:, :size]
        # the slack of each number is how far it lies outside the goal's box, on either side
        rows = [np.hstack([end, -np.eye(n)]), np.hstack([-end, -np.eye(n)])]
        room = [self.goal.half - off, self.goal.half + off]
        reach = self._radius * (self._high - self._low)
        low = np.maximum(self._low - controls, -reach).ravel()
        high = np.minimum(self._high - controls, reach).ravel()
        weights, bounds = self.goal.weights, np.column_stack([low, high])
        bounds = np.concatenate([bounds, np.tile([0.0, np.inf], (n, 1))])
        cost = np.concatenate([np.zeros(size), weights])
        matrix, limit = np.vstack(rows), np.concatenate(room)
        if effort:  # one more variable a control: its size after the change
            scale = 1.0 / np.maximum(np.abs(self._low), np.abs(self._high))
            scaled = np.diag(np.tile(scale, horizon))
            sizes = np.hstack([scaled, np.zeros((size, n)), -np.eye(size)])
            matrix = np.vstack(
                [np.hstack([matrix, np.zeros((len(matrix), size))]), sizes, sizes * _flip(size, n)]
            )
            now = (controls * scale).ravel()
            limit = np.concatenate([limit, -now, now])
            cost = np.concatenate([np.zeros(size), EFFORT_PENALTY * weights, np.ones(size)])
            bounds = np.concatenate([bounds, np.tile([0.0, np.inf], (size, 1))])
        solved = linprog(cost, A_ub=matrix, b_ub=limit, bounds=bounds, method="highs")
        for _ in range(MAX_CUTS):
            if solved.x is None:
                return None
            crossed = self._crossed_limits(plan, model, solved.x[:size])
            if not len(crossed[1]):
                break
            padding = np.zeros((len(crossed[1]), matrix.shape[1] - size))
            matrix = np.vstack([matrix, np.hstack([crossed[0], padding])])
            limit = np.concatenate([limit, crossed[1]])
            solved = linprog(cost, A_ub=matrix, b_ub=limit, bounds=bounds, method="highs")
        if solved.x is None:
            return None
        return solved.x[:size].reshape(controls.shape), float(weights @ solved.x[size : size + n])

    def _crossed_limits(
        self, plan: Trajectory, model: _Model, change: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows for the limits and clearances a change would cross: few, so they are added when needed."""
        horizon = change.size // plan.controls.shape[1]
        rows, room = [np.empty((0, change.size))], [np.empty(0)]
        for s, t in self.space.bounded:
            answer = model.answers[1 : horizon + 1, t, : change.size]
            moved = answer @ change
            for sign, bound in ((1.0, self.space.high[s]), (-1.0, self.space.low[s])):
                left = sign * (bound - plan.states[1 : horizon + 1, s])
                allowed = np.maximum(left - LIMIT_MARGIN, 0.0)
                crossed = np.flatnonzero(sign * moved > allowed + 0.1 * LIMIT_MARGIN)
                rows.append(sign * answer[crossed])
                room.append(allowed[crossed])
        positions = model.answers[: horizon + 1, : self.space.num_dofs, : change.size]
        gained = np.einsum("kpd,kd->kp", model.slopes[: horizon + 1], positions @ change)
        allowed = np.maximum(model.distances[: horizon + 1] - CLEARANCE, 0.0)
        for k, pair in np.argwhere(-gained > allowed + 0.1 * CLEARANCE):
            rows.append(-(model.slopes[k, pair] @ positions[k])[None])
            room.append(allowed[k, pair][None])
        return np.concatenate(rows), np.concatenate(room)

    def _closed_loop(
        self, plan: Trajectory, gains: np.ndarray, change: np.ndarray, promised: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Simulates shares of a change with feedback towards what they promise."""
        simulator, space, count = self.simulator, self.space, len(SHARES)
        ids = np.arange(count, dtype=np.int32)
        states = np.empty((count, len(change) + 1, space.size))
        controls = np.empty((count, *change.shape))
        states[:, 0] = plan.states[0]
        simulator.reset(states[:, 0], ids)
        allowed = np.ones(count, dtype=bool)
        for k in range(len(change)):
            aim = space.integrate(plan.states[k], SHARES[:, None] * promised[k])
            off = space.difference(states[:, k], aim)
            wanted = plan.controls[k] + SHARES[:, None] * change[k] - off @ gains[k].T
            controls[:, k] = np.clip(wanted, self._low, self._high)
            simulator.step(controls[:, k], self._stride, ids=ids)
            states[:, k + 1] = simulator.states()[:count]
            allowed &= simulator.allowed(count)
        return states, controls, allowed & ~simulator.diverged()[:count]

    def _follow(self, start: np.ndarray, controls: np.ndarray, guess: np.ndarray) -> Trajectory:
        """The plan in blocks; where a block is several steps, feedback keeps it on the states of the plan."""
        plan = self._open_loop(start, controls)
        if self._stride == 1:
            return plan
        states = plan.states[:: self._stride][: len(guess)]
        path = Trajectory(np.concatenate([states, plan.states[-1:]]), guess)
        promised = np.zeros((len(guess) + 1, self.space.tangent_size))
        gains = self._model(path).gains
        followed, applied, _ = self._closed_loop(path, gains, np.zeros_like(guess), promised)
        return Trajectory(followed[0], applied[0])

    def _open_loop(self, start: np.ndarray, controls: np.ndarray) -> Trajectory:
        states, ids = [start], np.array([0], dtype=np.int32)
        self.simulator.reset(start[None], ids)
        for control in controls:
            self.simulator.step(control[None], ids=ids)
            states.append(self.simulator.states()[0])
        return Trajectory(np.stack(states), controls)


def _flip(size: int, n: int) -> np.ndarray:
    """Turns `u <= e` into `-u <= e`: the sign of the first `size` columns."""
    return np.concatenate([-np.ones(size), np.ones(n), np.ones(size)])
