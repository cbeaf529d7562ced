"""Checks that a planning problem fits its model, before a search is wasted on it."""

import mujoco
import numpy as np

from planspace.errors import PlanspaceError, UsageError, unknown
from planspace.physics.constraints import MAX_DEPTH, TOLERANCE, Constraints
from planspace.physics.simulator import Simulator, control_bounds
from planspace.physics.space import StateSpace
from planspace.physics.supported import check_supported
from planspace.tasks.problem import Box, Goal, Problem

MAX_TURNS = 2
"""A larger angle in a start or a goal is taken for degrees."""


def check_problem(problem: Problem, where: str) -> None:
    """Check that a problem fits its model and that its goal can be entered.

    Args:
        problem: the problem.
        where: the file it comes from, or its name, for messages.

    Raises:
        UsageError: it does not fit.
    """
    try:
        model, space = problem.compile()
    except PlanspaceError as error:
        raise UsageError(f"{where}: {error}") from error
    try:
        check_supported(model)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from error
    if twice := [name for i, name in enumerate(problem.joints) if name in problem.joints[:i]]:
        raise UsageError(f"{where}: joints: {twice[0]!r} comes twice.")
    moving = [model.joint(i).name for i in range(model.njnt)]
    left_out = [name for name in moving if name not in problem.joints]
    if left_out:
        raise UsageError(
            f"{where}: the model moves the joint {left_out[0]!r}, which is not in joints; add it, or take it "
            "out of the model."
        )
    if problem.kinematic and Constraints(model, space).has_equalities:
        raise UsageError(
            f"{where}: the model has equalities, which a kinematic problem would ignore; remove them from "
            "the model, or leave out kinematic."
        )
    _check_sizes(problem, space, where)
    _check_bodies(problem, model, where)
    _check_limits(model, space, where)
    _check_goal(problem, model, space, where)
    try:
        problem.task.check(space.names, space.num_dofs, space.tangent_size - space.num_activations)
        problem.task.horizon(model.opt.timestep)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from error


def _check_sizes(problem: Problem, space: StateSpace, where: str) -> None:
    sizes = [
        ("start", problem.start.low, space.size),
        ("goal", problem.goal.low, space.size),
        ("goal_weights", problem.goal_weights, space.tangent_size),
        ("feature_weights", problem.feature_weights, space.tangent_size),
        ("sample_velocity", problem.sample_velocity, space.num_dofs),
    ]
    for key, got, wanted in sizes:
        without = wanted if key == "sample_velocity" else wanted - space.num_activations
        if len(got) not in ((wanted, without) if key in ("start", "goal") else (0, wanted, without)):
            also = f", or {without} without the activations" if without < wanted else ""
            raise UsageError(f"{where}: {key} must have {wanted} numbers{also}, got {len(got)}.")
    for key in ("start", "goal"):
        box = problem.box(key, space)
        _check_bounds(key, box, space, where)
        _check_activations(key, box, space, where)
    if problem.goal_weights and not any(problem.goal_weights):
        raise UsageError(f"{where}: goal_weights are all 0, so that every state would be at the goal.")


def _check_bounds(key: str, box: Box, space: StateSpace, where: str) -> None:
    """Check that a box is within the bounds, that angles are not degrees, and that quaternions are not 0."""
    sides = np.array([box.low, box.high])
    for column in space.circular_columns:
        if (turns := np.abs(sides[:, column]).max() / (2 * np.pi)) > MAX_TURNS:
            raise UsageError(
                f"{where}: {key}: {space.names[column]!r} is an angle in radians, and {turns:.3g} turns are "
                "too many; convert degrees."
            )
    for column in space.quaternion_columns:
        if not sides[:, column : column + 4].any():
            raise UsageError(f"{where}: {key}: {space.names[column]!r} begins a quaternion of length 0.")
    low, high = space.ranges(space.velocity_bound)
    outside = ((sides < low) | (sides > high))[:, : space.velocities.stop]
    for column in np.flatnonzero(outside.any(axis=0)):
        raise UsageError(
            f"{where}: {key}: {space.names[column]!r} must lie between {low[column]:g} and {high[column]:g}, "
            f"got {box.low[column]:g} to {box.high[column]:g}. These are the joint limits or velocity_bound."
        )
    if not space.in_bounds(space.normalise(sides)).all():
        raise UsageError(f"{where}: {key} reaches outside the joint limits or the velocity bound.")


def _check_activations(key: str, box: Box, space: StateSpace, where: str) -> None:
    low, high = (np.array(side[space.velocities.stop :]) for side in (box.low, box.high))
    names, least, most = space.activations[:3]
    for i in np.flatnonzero((low < least) | (high > most)):
        raise UsageError(
            f"{where}: {key}: {names[i]!r} must lie between {least[i]:g} and {most[i]:g}, as the model says; "
            f"got {low[i]:g} to {high[i]:g}."
        )


def _check_bodies(problem: Problem, model: mujoco.MjModel, where: str) -> None:
    known = [model.body(i).name for i in range(1, model.nbody)]
    for body, _ in problem.body_features:
        if body not in known:
            raise UsageError(f"{where}: {unknown('body in body_features', body, known)}")


def _check_limits(model: mujoco.MjModel, space: StateSpace, where: str) -> None:
    if model.nu == 0 and not space.kinematic:
        raise UsageError(
            f"{where}: the model has no actuator that moves these joints, so there is nothing to control."
        )
    for i in np.flatnonzero(~np.isfinite(control_bounds(model, space)).all(axis=0)):
        name = model.actuator(i).name
        raise UsageError(
            f"{where}: the actuator {repr(name) if name else i} has no control range; give it a ctrlrange in "
            "the model, or give control_bounds."
        )
    low, high = space.ranges(space.velocity_bound)
    free = [part for part in space.layout if part.kind in ("slide", "hinge", "activation")]
    free = [part for part in free if not np.isfinite([low[part.state], high[part.state]]).all()]
    if free:
        what = "actuator an actrange" if free[0].kind == "activation" else "joint position_bounds"
        raise UsageError(f"{where}: {space.names[free[0].state]!r} has no limits; give its {what}.")


def _check_goal(problem: Problem, model: mujoco.MjModel, space: StateSpace, where: str) -> None:
    """Check that the goal is one region and that its centre is a valid state."""
    if problem.goal_random:
        return
    for column in space.quaternion_columns:
        if problem.goal.low[column : column + 4] != problem.goal.high[column : column + 4]:
            raise UsageError(
                f"{where}: goal: a box cannot span rotations; use goal_weights of 0 to leave directions free."
            )
    simulator = Simulator(model, space, 1, threads=1, validity=problem.validity)
    goal = problem.draw_goal(space, np.random.default_rng(0))
    if not simulator.valid_states(goal.center[None])[0]:
        raise UsageError(f"{where}: goal: it is in collision, or the predicate rejects it.")
    _check_possible(goal, simulator.constraints, where)


def _check_possible(goal: Goal, constraints: Constraints, where: str) -> None:
    """Check that the model allows a state in the goal region."""
    size, equality = constraints.violation(goal.center)
    if size > TOLERANCE:
        nearest = constraints.project(goal.center)
        if nearest is None or not goal.reached(nearest):
            raise UsageError(
                f"{where}: goal: the equality {equality!r} of the model does not hold there, by {size:.3g}, "
                "and it holds nowhere in the goal region."
            )
    whole_pose = bool((goal.weights[: goal.space.num_dofs] > 0).all())  # else free joints may move away
    depth, bodies = constraints.overlap(goal.center)
    if whole_pose and depth > MAX_DEPTH:
        names = " and ".join(map(repr, bodies))
        raise UsageError(
            f"{where}: goal: the bodies {names} are inside one another by {depth:.3g} m. Move the goal, or "
            "let these geoms not collide (contype and conaffinity)."
        )
