"""Steps of a task along plans: the plan's controls, and what the task makes of them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.demos.dataset import Demos
from planspace.errors import UsageError
from planspace.plan.tracking import average_controls, deviations, next_rows, regulators_along
from planspace.rl.observe import Observer
from planspace.rl.progress import Progress
from planspace.rl.settable import Settable, SettableGym, SettableTask
from planspace.rl.transitions import Transitions

COPIES = 10
"""States beside each state of a plan."""


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
    settable: Settable,
    states: Float[np.ndarray, "step settable"],
    controls: Float[np.ndarray, "step control"],
    following: Int[np.ndarray, " step"],
    noise: float,
) -> tuple[Float[np.ndarray, "copy settable"], Float[np.ndarray, "copy control"]]:
    """States beside the plans, and controls that lead from there back to the plan.

    The noise is Gaussian, and smaller in some copies than in others: each draws a factor between 0 and 1. In
    a task of planspace, the controls are those of a linear regulator along the plan (`regulators_along`),
    clipped to their limits. In a Gymnasium environment, the noise moves only the joints with a position
    servo, and the controls are the plan's, by which a servo returns to the plan.

    Args:
        settable: takes the steps of the task.
        states: the states of the plans.
        controls: the control of a step from each of them.
        following: the row of `states` to which that step leads; -1 where the plan ends.
        noise: the largest standard deviation of the noise, in standard deviations of the states.

    Returns:
        `COPIES` copies of all states, one after another.
    """
    space, rng = settable.space, np.random.default_rng(0)
    assert space is not None, "`Plans` checks this"
    joints = states[:, : space.size]
    spread = deviations(space, joints)
    sizes = noise * rng.uniform(size=(COPIES, len(states), 1))
    moves = sizes * spread * rng.standard_normal((COPIES, len(states), len(spread)))
    corrected = np.broadcast_to(controls, (COPIES, *controls.shape))
    if isinstance(settable, SettableTask):
        gains, _ = regulators_along(
            settable.simulator, joints, controls, following, settable.physics_steps, spread
        )
        corrected = controls - np.einsum("kij,ckj->cki", gains, moves)
    elif isinstance(settable, SettableGym):
        moves *= settable.driven
    beside = np.tile(states, (COPIES, 1))
    beside[:, : space.size] = space.integrate(joints, moves).reshape(-1, space.size)
    return settable.normalise(beside), np.clip(corrected, *settable.limits).reshape(-1, controls.shape[1])


def _goals(demos: Demos, rows: Int[np.ndarray, " step"]) -> Float[np.ndarray, "step settable"]:
    """The goal of the plan of each row, or its last state if the goal is not known."""
    known = np.isfinite(demos.goals).all(axis=1, keepdims=True)
    goals = np.where(known, demos.goals, demos.states[demos.offsets[1:] - 1])
    return goals[np.searchsorted(demos.offsets, rows, side="right") - 1]


def _no_steps() -> UsageError:
    """Build the error for plans without a step that can be used."""
    return UsageError("the plans have no step of the task that could be used: give longer plans.")
