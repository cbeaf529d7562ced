"""Make a plan short: sequential linear programming over its controls, simulated in closed loop.

A plan from a random tree wanders. Here its dynamics are linearised along it; a linear program finds the
change of all controls at once, within their bounds, the joints' limits and a trust region, after which the
state at an earlier horizon lies in the goal region. Several fractions of the change are simulated, with
feedback towards the states that the linear model promises. The horizon shrinks until no program finds a
shorter plan. `polish_program` holds the linear program, `polish_rollout` the simulations, and
`polish_repair` what is done if a plan does not reach its goal.

Rejected: iterative LQR with a terminal cost (it lands, but has no notion of the shortest horizon); shortcuts
between states of the plan (two states of an underactuated plant can rarely be joined by a shorter edge).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from planspace.physics.simulator import Simulator
from planspace.plan.clearance import Clearance
from planspace.plan.config import PolishConfig
from planspace.plan.durations import num_steps
from planspace.plan.polish_program import Change, Limits, LinearModel, solve_program
from planspace.plan.polish_repair import MAX_KNOTS, STRETCHES, Repair, continued_to_goal, without_contacts
from planspace.plan.polish_rollout import Candidate, Rollout
from planspace.plan.trajectory import Trajectory
from planspace.tasks.problem import Goal

SHORTEST = 0.7
"""A horizon shrinks at once to no less than this fraction of the plan."""
RADII = (0.03, 0.1, 0.3, 1.0)
"""Fractions of the trust region in which a program is tried, the smallest first."""
GENTLE = 0.25
"""A program reaches the goal if it promises to come within this fraction of the tolerance."""
WIDER = 4.0
"""The trust region grows by this factor after a change that was right as a whole."""
LEAST_TRUST = 0.3
"""The trust region shrinks by no more than this factor at once."""
SMALLEST_RADIUS = 1e-3
"""The trust region never shrinks below this fraction of a control's range."""
REPAIR_MARGIN = 0.01
"""`velocity_margin` of repairs if it is 0: the way to the goal that they start from may exceed the bounds."""
PATIENCE = 4
"""An aim is given up after this many changes that brought little; one that brought nothing counts twice."""


class Trust(NamedTuple):
    """How far the linear model is trusted, and how many programs may still be tried."""

    radius: float
    """Size of the trust region, as a fraction of each control's range."""
    left: int
    """Iterations left: linear programs with a simulation after them."""

    def after(self, fraction: float) -> "Trust":
        """Widen the region after a change that was right as a whole, else narrow it.

        Args:
            fraction: the fraction of the change that was used; 0 if none was.
        """
        factor = WIDER if fraction == 1.0 else max(fraction, LEAST_TRUST)
        return self._replace(radius=float(np.clip(factor * self.radius, SMALLEST_RADIUS, 1.0)))


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
        """Prepare the polish.

        Args:
            simulator: at least 8 simulations; overwritten.
            goal: where plans end.
            weights: weight of each number of a tangent in the feedback.
            config: the other settings.
            clearance: measures the distance of geoms that must not touch; without it, contacts are only
                checked.
            effort: minimise the controls' effort at the plan's duration, instead of the duration.
        """
        self._simulator, self._goal, self._config, self._effort = simulator, goal, config, effort
        low, high = simulator.control_low, simulator.control_high
        self._limits = Limits(simulator.space, goal, low, high, config.velocity_margin)
        self._clearance = clearance
        self._weights = weights
        self._state_cost = np.asarray(weights, dtype=float) ** 2
        self._control_cost = config.tracking_cost / (0.5 * (high - low)) ** 2

    def run(
        self, start: Float[np.ndarray, " state"], controls: Float[np.ndarray, "step control"]
    ) -> Float[np.ndarray, "shorter control"] | None:
        """Land a plan in the goal region, then make it as short, or as light, as possible.

        Args:
            start: where it starts.
            controls: one per physics step; the plan need not reach the goal.

        Returns:
            The controls of the best plan found, one per physics step; None if none reaches the goal.
        """
        if len(controls) == 0:
            return None
        found = self._run(start, controls)
        if found is None and self._config.repairs:
            found = self._within_velocities()._mended(start, controls)
        return found

    def _within_velocities(self) -> "Polish":
        """The same polish, which keeps velocities below their bounds."""
        margin = self._config.velocity_margin or REPAIR_MARGIN
        return Polish(
            self._simulator,
            self._goal,
            self._weights,
            replace(self._config, velocity_margin=margin),
            clearance=self._clearance,
            effort=self._effort,
        )

    def _run(self, start: np.ndarray, controls: np.ndarray) -> np.ndarray | None:
        least = num_steps(self._config.step_s, self._simulator.model)
        stride = max(least, -(-len(controls) // self._config.max_blocks))
        rollout = Rollout(self._simulator, self._clearance, self._state_cost, self._control_cost, stride)
        trust = Trust(1.0, self._config.max_iterations)
        best, trust = self._land(rollout, rollout.in_blocks(start, controls), trust)
        if best is None:
            return None
        improve = self._lighten if self._effort else self._shorten
        return np.repeat(improve(rollout, best, trust).controls, stride, axis=0)

    def _mended(self, start: np.ndarray, controls: np.ndarray) -> np.ndarray | None:
        """A plan that does not arrive, continued to the goal and shortened; None if that fails."""
        simulator = without_contacts(self._simulator) if self._clearance else self._simulator
        for stretch in STRETCHES:
            rollout, guess = self._guess(simulator, start, controls, stretch)
            if guess is None:
                return None
            mended = Repair(rollout, self._limits, self._config.repairs).run(guess)
            if mended is not None:
                return self._run(start, np.repeat(mended.controls, rollout.stride, axis=0))
        return None

    def _guess(
        self, simulator: Simulator, start: np.ndarray, controls: np.ndarray, stretch: float
    ) -> tuple[Rollout, Trajectory | None]:
        """A plan and a way from it to the goal, in steps so long that there are few."""
        stride = num_steps(self._config.step_s, simulator.model)
        while True:
            rollout = Rollout(simulator, self._clearance, self._state_cost, self._control_cost, stride)
            guess = continued_to_goal(rollout, self._limits, rollout.in_blocks(start, controls), stretch)
            if guess is None or len(guess.controls) <= MAX_KNOTS:
                return rollout, guess
            stride *= 2

    def _land(self, rollout: Rollout, plan: Trajectory, trust: Trust) -> tuple[Trajectory | None, Trust]:
        landed = self._cut(plan)
        if landed is not None:
            return landed, trust
        return self._aim(rollout, plan, len(plan.controls), rollout.linear_model(plan), trust)

    def _shorten(self, rollout: Rollout, best: Trajectory, trust: Trust) -> Trajectory:
        """Aim at earlier and earlier horizons."""
        while trust.left > 0 and len(best.controls) > 1:
            length, model = len(best.controls), rollout.linear_model(best)
            horizon = self._reachable(best, model, trust.radius)
            shorter, trust = self._aim(rollout, best, horizon, model, trust)
            while shorter is None and horizon < length - 1:
                horizon = max(horizon + 1, (horizon + length) // 2)
                trust = trust._replace(radius=1.0)
                shorter, trust = self._aim(rollout, best, min(horizon, length - 1), model, trust)
            if shorter is None:
                return best
            best = shorter
        return best

    def _lighten(self, rollout: Rollout, best: Trajectory, trust: Trust) -> Trajectory:
        """Minimise the effort at a fixed duration."""
        misses, model = 0, rollout.linear_model(best)
        while trust.left > 0 and misses < PATIENCE:
            trust = trust._replace(left=trust.left - 1)
            change = solve_program(self._limits, best, model, len(best.controls), trust.radius, effort=True)
            tried = rollout.changed(best, model, change.controls) if change is not None else []
            landed = [self._cut(each.plan) for each in tried]
            lighter = [plan for plan in landed if plan is not None and self._spent(plan) < self._spent(best)]
            if lighter:
                best, misses = min(lighter, key=self._spent), 0
                model = rollout.linear_model(best)
            else:
                misses, trust = misses + 1, trust.after(0.0)
        return best

    def _aim(
        self, rollout: Rollout, plan: Trajectory, horizon: int, model: LinearModel, trust: Trust
    ) -> tuple[Trajectory | None, Trust]:
        """Change a plan until it reaches the goal by the horizon; None if the changes stop helping."""
        stalled, before = 0, float(self._goal.distance(plan.states[horizon]))
        while trust.left > 0 and stalled < PATIENCE:
            change, trust = self._gentlest(plan, model, horizon, trust)
            tried = rollout.changed(plan, model, change.controls) if change is not None else []
            if (landed := self._shortest_landed(tried)) is not None:
                return landed.plan, trust.after(landed.fraction)
            ends = [float(self._goal.distance(each.plan.states[-1])) for each in tried]
            if ends and min(ends) < before - 1e-3:
                fraction, plan = tried[int(np.argmin(ends))]
                stalled = stalled + 1 if min(ends) > 0.9 * before else 0
                before, model = min(ends), rollout.linear_model(plan)
                trust = trust.after(fraction)
            else:
                stalled, trust = stalled + 2, trust.after(0.0)
        return None, trust

    def _gentlest(
        self, plan: Trajectory, model: LinearModel, horizon: int, trust: Trust
    ) -> tuple[Change | None, Trust]:
        """The change in the smallest trust region in which a program reaches the goal.

        A linear program that can reach the goal in many ways picks a corner, with every control at the edge
        of its region. The smaller the region, the better the linear model holds.

        Returns:
            The change, or None if no program has a solution; and the region that was tried last.
        """
        change, radius = None, trust.radius
        for fraction in RADII:
            radius = fraction * trust.radius
            change = solve_program(self._limits, plan, model, horizon, radius, effort=False) or change
            if change is not None and change.distance <= GENTLE * self._goal.tolerance:
                break
        return change, Trust(radius, trust.left - 1)

    def _reachable(self, plan: Trajectory, model: LinearModel, radius: float) -> int:
        """The shortest horizon at which the linear model reaches the goal within the trust region."""
        low, high = max(1, int(SHORTEST * len(plan.controls))), len(plan.controls) - 1
        while low < high:
            middle = (low + high) // 2
            change = solve_program(self._limits, plan, model, middle, radius, effort=False)
            if change is not None and change.distance <= 0.5 * self._goal.tolerance:
                high = middle
            else:
                low = middle + 1
        return high

    def _shortest_landed(self, tried: list[Candidate]) -> Candidate | None:
        """The shortest of the plans that reach the goal, cut where they do."""
        cut = [(each.fraction, self._cut(each.plan)) for each in tried]
        landed = [Candidate(fraction, plan) for fraction, plan in cut if plan is not None]
        return min(landed, key=lambda each: len(each.plan.controls), default=None)

    def _cut(self, plan: Trajectory) -> Trajectory | None:
        """The plan up to the state that first lies in the goal region; None if none does."""
        inside = self._goal.distance(plan.states) <= self._config.landing * self._goal.tolerance
        if not inside.any():
            return None
        end = int(inside.argmax())
        return Trajectory(plan.states[: end + 1], plan.controls[:end])

    def _spent(self, plan: Trajectory) -> float:
        """The effort of a plan: the sum of its controls, as fractions of their range."""
        largest = np.maximum(np.abs(self._limits.low), np.abs(self._limits.high))
        return float(np.abs(plan.controls / largest).sum())
