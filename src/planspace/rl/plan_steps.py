"""Steps of a task along plans: the plan's controls, and what the task makes of them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.errors import UsageError
from planspace.plan.linearise import along, tracking_gains
from planspace.progress import progress_over
from planspace.rl.observe import Observer
from planspace.rl.progress import Progress
from planspace.rl.settable import BLOCK, Settable, SettableTask
from planspace.rl.transitions import Transitions

COPIES = 10
"""States beside each state of a plan."""
END_REPEATS = 200
"""Steps for which the regulator holds the end of a plan."""
TIME_TOLERANCE = 1e-6
"""Steps by which a plan may end too early for its last step; times are rounded."""


def plan_steps(
    demos: Demos,
    settable: Settable,
    observer: Observer,
    alive: Bool[np.ndarray, " row"],
    progress: Progress | None = None,
    noise: float = 0.0,
) -> Transitions:
    """One step of the task from each state of the plans.

    The control of a step is the plan's, averaged over the step and clipped to its limits. The simulation of
    the task gives the next state. Steps that start where an episode would have ended are left out, and so are
    those that last beyond the end of their plan and those whose physics diverge.

    Where the task's targets are states, the target is the goal of the plan, or its last state if the goal is
    not known. Otherwise targets are drawn as the task draws them.

    Args:
        demos: the plans, with the states that are set.
        settable: takes the steps of the task.
        observer: what policy and critic observe.
        alive: whether an episode goes on at each state of the plans.
        progress: computes the rewards, if they are not the task's.
        noise: if above 0, steps beside the plans follow; see `beside_plans`.

    Raises:
        UsageError: no step remains.
    """
    parts = [average_controls(demos.episode(i), settable.duration) for i in range(len(demos))]
    starts = demos.offsets[:-1]
    rows = np.concatenate([start + np.arange(len(part)) for start, part in zip(starts, parts, strict=True)])
    kept = alive[rows]
    if not kept.any():
        raise _no_steps()
    rows, controls = rows[kept], np.clip(np.concatenate(parts)[kept], *settable.limits)
    states = settable.normalise(demos.states)[rows]
    if noise:
        assert isinstance(settable, SettableTask), "`Plans` checks this"
        following = next_rows(demos, rows, settable.duration)
        beside, corrections = beside_plans(settable, states, controls, following, noise)
        kept = settable.goes_on(beside)
        rows = np.concatenate([rows, np.tile(rows, COPIES)[kept]])
        states, controls = (
            np.concatenate([states, beside[kept]]),
            np.concatenate([controls, corrections[kept]]),
        )
    actions = controls.astype(np.float32)
    targets = settable.targets(_goals(demos, rows))
    steps = settable.step(states, actions, targets)
    kept = ~steps.diverged
    if not kept.any():
        raise _no_steps()
    actions, targets = actions[kept], targets[kept]
    before, rewards, after, terminated, _ = (array[kept] for array in steps)
    observe, paid = replace(observer, num_seeds=1), progress and replace(progress, num_seeds=1)
    if paid is not None:
        rewards = paid(before, after, targets)
    return Transitions(observe(before, targets), actions, rewards, observe(after, targets), terminated)


def beside_plans(
    settable: SettableTask,
    states: Float[np.ndarray, "step state"],
    controls: Float[np.ndarray, "step control"],
    following: Int[np.ndarray, " step"],
    noise: float,
) -> tuple[Float[np.ndarray, "copy state"], Float[np.ndarray, "copy control"]]:
    """States beside the plans, and controls that lead from there back to the plan.

    The noise is Gaussian, and smaller in some copies than in others: each draws a factor between 0 and 1. The
    controls are those of a time-varying linear regulator along the plan, clipped to their limits. Its costs
    are the squares of the distances in standard deviations of the states, and of the controls in halves of
    their ranges.

    Args:
        settable: takes the steps of the task.
        states: the states of the plans.
        controls: the control of a step from each of them.
        following: the row of `states` to which that step leads; -1 where the plan ends.
        noise: the largest standard deviation of the noise, in standard deviations of the states.

    Returns:
        `COPIES` copies of all states, one after another.
    """
    simulator, rng = settable.simulator, np.random.default_rng(0)
    space, (low, high) = simulator.space, settable.limits
    spread = np.std(space.difference(states, states[0]), axis=0)
    state_cost = 1.0 / np.where(spread > 0, spread, 1.0) ** 2
    half = np.where(np.isfinite(high - low), (high - low) / 2, np.maximum(np.abs(controls).max(axis=0), 1.0))
    blocks = [slice(first, first + BLOCK) for first in range(0, len(states), BLOCK)]
    slopes = [
        along(simulator, states[rows], controls[rows], settable.physics_steps)
        for rows in progress_over(blocks, "linearise", unit="block", total=len(blocks))
    ]
    a, b = map(np.concatenate, zip(*slopes, strict=True))
    gains = tracking_gains(a, b, state_cost, 1.0 / half**2, following, END_REPEATS)
    sizes = noise * rng.uniform(size=(COPIES, len(states), 1))
    moves = sizes * spread * rng.standard_normal((COPIES, len(states), len(spread)))
    corrected = controls - np.einsum("kij,ckj->cki", gains, moves)
    beside = settable.normalise(space.integrate(states, moves).reshape(-1, states.shape[1]))
    return beside, np.clip(corrected, low, high).reshape(-1, controls.shape[1])


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


def average_controls(episode: Episode, duration: float) -> Float[np.ndarray, "step control"]:
    """Average the controls of a plan over a step of this duration from each of its states.

    Args:
        episode: the plan.
        duration: the duration of a step [s].

    Returns:
        The control of each step that ends within the plan: of the first states, in order.
    """
    times = episode.times
    whole = np.count_nonzero(times + duration <= times[-1] + TIME_TOLERANCE * duration)
    ends = np.minimum(times[:whole] + duration, times[-1])
    integral = np.zeros((len(times), episode.controls.shape[1]))
    np.cumsum(episode.controls * np.diff(times)[:, None], axis=0, out=integral[1:])
    after = [np.interp(ends, times, column) for column in integral.T]
    return (np.stack(after, axis=1) - integral[:whole]) / duration


def _goals(demos: Demos, rows: Int[np.ndarray, " step"]) -> Float[np.ndarray, "step settable"]:
    """The goal of the plan of each row, or its last state if the goal is not known."""
    known = np.isfinite(demos.goals).all(axis=1, keepdims=True)
    goals = np.where(known, demos.goals, demos.states[demos.offsets[1:] - 1])
    return goals[np.searchsorted(demos.offsets, rows, side="right") - 1]


def _no_steps() -> UsageError:
    """Build the error for plans without a step that can be used."""
    return UsageError("the plans have no step of the task that could be used: give longer plans.")
