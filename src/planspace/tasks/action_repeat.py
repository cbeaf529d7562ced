"""Holding each action for several steps of a task, as results on DeepMind Control are usually reported."""

from dataclasses import replace

from planspace.errors import UsageError, check_whole
from planspace.tasks.gymnasium import AnyTask, GymTask
from planspace.tasks.task import Task


def repeat_actions(task: AnyTask, num: int) -> AnyTask:
    """Return the task with each action held for `num` of its own steps, whose rewards are summed.

    Its horizon is then the number of actions in an episode. A task whose actions are repeated already gets
    the new number.

    Raises:
        UsageError: the number is below 1 or does not divide the horizon, or the task is a Gymnasium
            environment.
    """
    check_whole("action_repeat", num)
    own = single_actions(task)
    if num == 1:
        return own
    if isinstance(own, GymTask):
        raise UsageError(
            f"--action-repeat {num} is for planspace's own tasks, but {own.name} is a Gymnasium environment: "
            "leave it out, or register the environment with a wrapper that repeats actions."
        )
    if own.horizon % num:
        raise UsageError(f"--action-repeat {num} must divide the {own.horizon} steps of {own.name}.")
    return replace(own, horizon=own.horizon // num, action_repeat=num)


def single_actions(task: AnyTask) -> AnyTask:
    """Return the task without repetition of actions."""
    if not isinstance(task, Task) or task.action_repeat == 1:
        return task
    return replace(task, horizon=task.horizon * task.action_repeat, action_repeat=1)
