"""The studies and budgets by name."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from planspace.errors import UsageError, unknown
from planspace.study.controls import controls
from planspace.study.demonstrations import demos
from planspace.study.design import BLOCK, Budget, Builder, Study
from planspace.study.paper import paper
from planspace.study.recipe import recipe
from planspace.study.shaping import shaping
from planspace.study.uses import uses
from planspace.tasks.catalog import find_task
from planspace.tasks.stored_task import task_content
from planspace.tasks.task import Task

BUDGETS: dict[str, Budget] = {
    "smoke": Budget(
        steps=12_000, seeds=2, plans=12, embeddings=2, restarts=1, fit_steps=300, guide_episodes=3
    ),
    "half": Budget(steps=1_000_000),
    "full": Budget(steps=2_000_000),
    "paper": Budget(steps=8_000_000),
}


STUDIES: dict[str, Callable[[str, Builder], Study]] = {
    "paper": paper,
    "controls": controls,
    "demos": demos,
    "shaping": shaping,
    "recipe": recipe,
    "uses": uses,
}
ANY_TASK = ("recipe", "controls", "uses")
"""The studies that can be run on any task with a planning problem."""


def make_study(name: str, budget: str, *, seeds: int = 0, task: str | Path | Task = "") -> Study:
    """Make a study.

    Args:
        name: a key of `STUDIES`.
        budget: a key of `BUDGETS`.
        seeds: seeds per arm; 0 uses the study's number.
        task: for a study in `ANY_TASK`: the name of a shipped task, the path of a problem file, or a task of
            your own; empty for the study's own tasks.

    Raises:
        UsageError: the study, the budget or the task is unknown, the study takes no task, the task has no
            planning problem, or `seeds` is not a multiple of `BLOCK`.
        PlanspaceError: the problem file or its model cannot be read.
    """
    if name not in STUDIES:
        raise unknown("study", name, STUDIES)
    if budget not in BUDGETS:
        raise unknown("budget", budget, BUDGETS)
    if seeds % BLOCK or seeds < 0:
        raise UsageError(f"`--seeds` must be a positive multiple of {BLOCK}, got {seeds}.")
    grid = Builder(BUDGETS[budget], seeds)
    if not task:
        return replace(STUDIES[name](budget, grid), seeds=seeds)
    given = task.name if isinstance(task, Task) else str(task)
    if name not in ANY_TASK:
        raise UsageError(
            f"study {name} has its own tasks: leave out {given}, or choose {' or '.join(ANY_TASK)}."
        )
    task = find_task(task)
    shipped = not task_content(task)
    study = STUDIES[name](budget, replace(grid, task=task.name if shipped else task))
    label = task.name if shipped else f"{task.name}-{task.hash[:8]}"  # files may have equal names
    return replace(study, task=given, folder=f"{name}-{label}-{budget}", seeds=seeds)
