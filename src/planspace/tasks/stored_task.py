"""The task of a run that was trained on a problem file: RUN/task/NAME.yaml and the files of its model."""

from pathlib import Path
from typing import Any

import yaml

from planspace.errors import PlanspaceError
from planspace.storage.files import make_folder, write_bytes
from planspace.tasks.action_repeat import single_actions
from planspace.tasks.catalog import shipped_tasks
from planspace.tasks.gymnasium import AnyTask, GymTask
from planspace.tasks.problem import Box, Problem
from planspace.tasks.problem_file import load_problem
from planspace.tasks.problem_task import GoalTask, task_of_problem
from planspace.tasks.task import Task
from planspace.tasks.task_values import plain_task_settings

FOLDER = "task"
"""The folder in a run that holds its task."""


def save_task(task: AnyTask, run: Path) -> None:
    """Write the task of a problem into a run, so that its policies can be played without the user's file.

    A task with functions of the user's own is not written, because a file holds no code. A Gymnasium
    environment is described in the settings of its run. The arms of a run or of a study share the large
    files of a model; see `write_or_link`.

    Raises:
        PlanspaceError: a file cannot be written.
    """
    functions = getattr(task.reward, "__self__", None) if isinstance(task, Task) else None
    if not isinstance(functions, GoalTask) or functions.problem.predicate is not None:
        return
    problem, folder = functions.problem, make_folder(run / FOLDER)
    problem.source.write(folder, _neighbours(run.absolute()))
    name = problem.name.replace("/", "-")  # not the task's, because the name is part of the task's hash
    write_bytes(folder / f"{name}.yaml", problem_yaml(problem).encode())


def _neighbours(run: Path) -> list[Path]:
    """The tasks of the run that an arm RUN/train/ARM belongs to, and of the folders next to it."""
    return [run.parent.parent / FOLDER, *sorted(run.parent.glob(f"*/{FOLDER}"))]


def task_content(task: AnyTask) -> dict[str, Any]:
    """What a run records of its task besides the name: nothing if planspace ships it."""
    if isinstance(task, GymTask):
        return {"environment": task.plain()}
    task = single_actions(task)
    return {} if shipped_tasks().get(task.name) == task else {"task_sha256": task.hash}


def stored_task(run: Path) -> Task | None:
    """Return the task that `save_task` wrote into a run; None if it wrote none.

    The folder may come from someone else: the model is read in a process of its own, in bounded time.

    Raises:
        PlanspaceError: the task cannot be read.
    """
    files = sorted((run / FOLDER).glob("*.yaml"))
    if not files:
        return None
    if len(files) > 1:
        raise PlanspaceError(f"{run / FOLDER} must hold one problem file, it holds {len(files)}.")
    return task_of_problem(load_problem(files[0], untrusted=True))


def problem_yaml(problem: Problem) -> str:
    """Return a problem as the text of a problem file, next to which the files of its model lie."""
    source = problem.source
    plain: dict[str, Any] = {
        "model": source.main,
        "joints": list(problem.joints),
        "held": {name: list(position) for name, position in source.held},
        "start": _box(problem.start),
        "goal": _box(problem.goal) | {"random": problem.goal_random},
        "tolerance": problem.tolerance,
        "goal_weights": list(problem.goal_weights),
        "feature_weights": list(problem.feature_weights),
        "body_features": dict(problem.body_features),
        "sample_velocity": list(problem.sample_velocity),
        "velocity_bound": list(problem.velocity_bound),
        "position_bounds": {
            name: {"low": list(low), "high": list(high)} for name, low, high in problem.position_bounds
        },
        "limit_slack": problem.limit_slack or None,
        "control_bounds": None if problem.control_bounds is None else _box(problem.control_bounds),
        "forbidden_contacts": problem.forbidden_contacts
        if isinstance(problem.forbidden_contacts, str)
        else [list(pair) for pair in problem.forbidden_contacts],
        "hold": problem.hold,
        "kinematic": problem.kinematic,
        "cost": problem.cost,
        "planner": problem.planner,
        "settings": dict(problem.settings),
        "task": plain_task_settings(problem.task),
    }
    given = {key: value for key, value in plain.items() if value not in (None, [], {})}
    return yaml.safe_dump(given, sort_keys=False)


def _box(box: Box) -> dict[str, list[float]]:
    return {"low": list(box.low), "high": list(box.high)}
