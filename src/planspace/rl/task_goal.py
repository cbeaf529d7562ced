"""The goal of a task as a state, from which an embedding computes distances, times and observations."""

from collections.abc import Callable

import numpy as np

from planspace.errors import UsageError
from planspace.physics.simulator import Simulator
from planspace.plan.linearise import at_rest
from planspace.tasks.gymnasium import AnyTask
from planspace.tasks.problem import Goal, Problem
from planspace.tasks.problem_file import load_problem
from planspace.tasks.task import Task

GoalStates = Callable[[np.ndarray], np.ndarray]
"""Targets [env, target] to the goal of each episode [env, state]."""


def has_goal_states(task: AnyTask) -> bool:
    """Whether the target of each episode is its goal, a whole state."""
    problem = task.problem if isinstance(task, Task) else None
    return isinstance(problem, Problem) and problem.goal_random and task.target_size == task.space.size


def goal_states(task: AnyTask, option: str) -> GoalStates:
    """Return what gives the goal of each episode as a state.

    Args:
        task: the task.
        option: the option that needs it, for messages.

    Raises:
        UsageError: the task has no goal, or its targets are not states.
    """
    if has_goal_states(task):
        return lambda targets: targets
    center = fixed_goal(task, option).center
    return lambda targets: np.broadcast_to(center, (len(targets), len(center)))


def fixed_goal(task: AnyTask, option: str) -> Goal:
    """The goal of the task's planning problem, with weight 0 for free activations and 1 for the rest.

    Args:
        task: the task.
        option: the option that needs it, for messages.

    Raises:
        UsageError: the task has no goal, or another target in every episode.
    """
    if not isinstance(task, Task) or not task.problem:
        raise UsageError(f"{option} needs a goal, but {task.name} has none: leave out {option}.")
    if task.target_size:
        raise UsageError(
            f"{option} needs one goal, but {task.name} has another target in every episode, and it is not a "
            f"state: leave out {option}."
        )
    problem, space = load_problem(task.problem), task.space
    box, weights = problem.box("goal", space), np.ones(space.tangent_size)
    first = space.tangent_velocities.stop
    weights[first:] = problem.weights_to_goal(space)[first:] > 0
    center = (np.array(box.low) + np.array(box.high)) / 2
    goal = Goal(space, center, np.zeros(space.tangent_size), weights, problem.tolerance)
    return at_rest(Simulator(*problem.compile(), 1, threads=1), goal) if space.num_activations else goal
