"""Steps of a task along plans: the plan's controls, and what the task makes of them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.errors import UsageError
from planspace.rl.observe import Observer
from planspace.rl.progress import Progress
from planspace.rl.settable import Settable
from planspace.rl.transitions import Transitions

TIME_TOLERANCE = 1e-6
"""Steps by which a plan may end too early for its last step; times are rounded."""


def plan_steps(
    demos: Demos,
    settable: Settable,
    observer: Observer,
    alive: Bool[np.ndarray, " row"],
    progress: Progress | None = None,
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

    Raises:
        UsageError: no step remains.
    """
    parts = [average_controls(demos.episode(i), settable.duration) for i in range(len(demos))]
    starts = demos.offsets[:-1]
    rows = np.concatenate([start + np.arange(len(part)) for start, part in zip(starts, parts, strict=True)])
    kept = alive[rows]
    if not kept.any():
        raise _no_steps()
    rows, controls = rows[kept], np.concatenate(parts)[kept]
    actions = np.clip(controls, *settable.limits).astype(np.float32)
    targets = settable.targets(_goals(demos, rows))
    steps = settable.step(settable.normalise(demos.states)[rows], actions, targets)
    kept = ~steps.diverged
    if not kept.any():
        raise _no_steps()
    actions, targets = actions[kept], targets[kept]
    before, rewards, after, terminated, _ = (array[kept] for array in steps)
    observe, paid = replace(observer, num_seeds=1), progress and replace(progress, num_seeds=1)
    if paid is not None:
        rewards = paid(before, after, targets)
    return Transitions(observe(before, targets), actions, rewards, observe(after, targets), terminated)


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
