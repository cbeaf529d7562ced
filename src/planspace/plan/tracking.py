"""Plans that a regulator follows: the control of each step, and the gains that lead back to the plan.

A time-varying linear quadratic regulator linearises the dynamics at each step of a plan x_k, u_k. It applies

    u = u_k - K_k (x - x_k),

and (x - x_k)' V_k (x - x_k) is its cost to go in the linear model.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.resample import resample
from planspace.errors import UsageError
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.linearise import along, time_varying_lqr
from planspace.progress import progress_over

BLOCK = 256
"""States that are linearised at once; results do not depend on it."""
END_REPEATS = 200
"""Steps for which the regulator holds the end of a plan."""
TIME_TOLERANCE = 1e-6
"""Steps by which a plan may end too early for its last step; times are rounded."""


@dataclass(frozen=True)
class TrackedPlans:
    """Steps along plans, one plan after another, with the regulator of each step."""

    space: StateSpace
    states: Float[np.ndarray, "step state"]
    """The state in which each step begins."""
    controls: Float[np.ndarray, "step control"]
    """What is held for the step."""
    remaining: Int[np.ndarray, " step"]
    """Steps from its beginning to the end of its plan, 1 or more. The next step of a plan is the next row."""
    gains: Float[np.ndarray, "step control tangent"]
    values: Float[np.ndarray, "step tangent tangent"]
    limits: tuple[Float[np.ndarray, " control"], Float[np.ndarray, " control"]]
    """Lower and upper limits of the controls."""

    @classmethod
    def of(cls, demos: Demos, simulator: Simulator, physics_steps: int, most: int) -> "TrackedPlans":
        """Cut plans into steps, counted back from their ends, and find their regulators.

        Args:
            demos: plans whose states are those of the simulator.
            simulator: its states are overwritten.
            physics_steps: physics steps for which a control is held.
            most: steps of a plan that are kept at most, the last ones.

        Raises:
            UsageError: no plan is as long as a step.
        """
        limits = simulator.control_low, simulator.control_high
        duration = physics_steps * float(simulator.model.opt.timestep)
        whole, states, controls, remaining = [], [], [], []
        for i in range(len(demos)):
            plan = demos.episode(i)
            even = resample(plan, demos.info, duration)
            starts = even.times + (plan.times[-1] - even.times[-1])
            found = average_controls(plan, duration, starts)
            last = slice(max(0, len(found) - most), len(found))
            whole.append(simulator.space.normalise(even.states[: len(found)]))
            states.append(whole[-1][last])
            controls.append(np.clip(found[last], *limits))
            remaining.append(np.arange(len(found), 0, -1)[last])
        steps = np.concatenate(states), np.concatenate(controls), np.concatenate(remaining)
        if not len(steps[0]):
            raise UsageError(f"no plan has a step of {duration:g} s: give longer plans.")
        following = np.where(steps[2] > 1, np.arange(len(steps[2])) + 1, -1)
        spread = deviations(simulator.space, np.concatenate(whole))
        gains, values = regulators_along(simulator, *steps[:2], following, physics_steps, spread)
        return cls(simulator.space, *steps, gains, values, limits)

    def control(
        self, rows: Int[np.ndarray, " batch"], off: Float[np.ndarray, "batch tangent"]
    ) -> Float[np.ndarray, "batch control"]:
        """The regulator's control, clipped to its limits.

        Args:
            rows: a step of a plan each.
            off: the tangents that lead from the states of the plans to the present ones; see `off`.
        """
        return np.clip(self.controls[rows] - np.einsum("kij,kj->ki", self.gains[rows], off), *self.limits)

    def off(
        self, rows: Int[np.ndarray, " batch"], states: Float[np.ndarray, "#batch state"]
    ) -> Float[np.ndarray, "batch tangent"]:
        """How far states, or one state, are off their plans."""
        return self.space.difference(states, self.states[rows])

    def cost_to_go(
        self, rows: Int[np.ndarray, " batch"], off: Float[np.ndarray, "batch tangent"]
    ) -> Float[np.ndarray, " batch"]:
        """The cost of the way back in the linear model."""
        return np.einsum("ki,kij,kj->k", off, self.values[rows], off)


def regulators_along(
    simulator: Simulator,
    states: Float[np.ndarray, "step state"],
    controls: Float[np.ndarray, "step control"],
    following: Int[np.ndarray, " step"],
    physics_steps: int,
    spread: Float[np.ndarray, " tangent"],
) -> tuple[Float[np.ndarray, "step control tangent"], Float[np.ndarray, "step tangent tangent"]]:
    """Gains and costs to go of a time-varying linear regulator along plans.

    Its costs are the squares of the distances in units of `spread`, and of the controls in halves of their
    ranges. It holds the end of each plan.

    Args:
        simulator: its states are overwritten.
        states: the states in which the steps begin.
        controls: the control of each step.
        following: the row of `states` to which a step leads; -1 where its plan ends.
        physics_steps: physics steps of a step.
        spread: unit of each number of a tangent, such as its standard deviation; 0 counts as 1.
    """
    low, high = simulator.control_low, simulator.control_high
    half = np.where(np.isfinite(high - low), (high - low) / 2, np.maximum(np.abs(controls).max(axis=0), 1.0))
    blocks = [slice(first, first + BLOCK) for first in range(0, len(states), BLOCK)]
    slopes = [
        along(simulator, states[rows], controls[rows], physics_steps)
        for rows in progress_over(blocks, "linearise", unit="block", total=len(blocks))
    ]
    a, b = map(np.concatenate, zip(*slopes, strict=True))
    state_cost = 1.0 / np.where(spread > 0, spread, 1.0) ** 2
    return time_varying_lqr(a, b, state_cost, 1.0 / half**2, following, END_REPEATS)


def deviations(space: StateSpace, states: Float[np.ndarray, "row state"]) -> Float[np.ndarray, " tangent"]:
    """Standard deviation of each number of a tangent over some states."""
    return np.std(space.difference(states, states[0]), axis=0)


def average_controls(
    episode: Episode, duration: float, starts: Float[np.ndarray, " time"] | None = None
) -> Float[np.ndarray, "step control"]:
    """Average the controls of a plan over steps.

    Args:
        episode: the plan.
        duration: the duration of a step [s].
        starts: when steps begin [s]; by default at each state of the plan.

    Returns:
        The control of each step that ends within the plan: of the first starts, in order.
    """
    times = episode.times
    starts = times if starts is None else starts
    whole = np.count_nonzero(starts + duration <= times[-1] + TIME_TOLERANCE * duration)
    integral = np.zeros((len(times), episode.controls.shape[1]))
    np.cumsum(episode.controls * np.diff(times)[:, None], axis=0, out=integral[1:])

    def until(instants: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(instants, times, column) for column in integral.T], axis=1)

    ends = np.minimum(starts[:whole] + duration, times[-1])
    return (until(ends) - until(starts[:whole])) / duration


def next_rows(demos: Demos, rows: Int[np.ndarray, " step"], duration: float) -> Int[np.ndarray, " step"]:
    """Which of the rows a step from each of them leads to, the nearest in time; -1 where there is none."""
    plan = np.searchsorted(demos.offsets, rows, side="right") - 1
    times, found = demos.times[rows], np.full(len(rows), -1)
    for i in np.unique(plan):
        own = np.flatnonzero(plan == i)
        after = times[own] + duration
        at = np.searchsorted((times[own][1:] + times[own][:-1]) / 2, after)
        gap = np.abs(times[own][at] - after)
        found[own] = np.where((gap < 0.5 * duration) & (at > np.arange(len(own))), own[at], -1)
    return found
