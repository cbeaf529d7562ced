"""The tasks by name: each module in `tasks/shipped` has one, and users can add their own."""

import importlib
import pkgutil
from pathlib import Path

from planspace.errors import UsageError, quoted, unknown
from planspace.tasks import shipped
from planspace.tasks.task import PAGE, Task


def shipped_tasks() -> dict[str, Task]:
    """Import every module in `tasks/shipped` and return its `TASK`, by the task's name."""
    names = [module.name for module in pkgutil.iter_modules(shipped.__path__, f"{shipped.__name__}.")]
    tasks = [importlib.import_module(name).TASK for name in names]
    return {task.name: task for task in tasks}


GYM_PREFIX = "gym:"
"""Start of the name of a Gymnasium environment as a task; see `tasks.gymnasium`."""
TASKS: dict[str, Task] = shipped_tasks()
"""The tasks that can be named: the shipped ones, and those that `add_task` added in this process."""


def add_task(task: Task) -> None:
    """Let a task of your own be found by its name in this process.

    Raises:
        UsageError: another task has this name.
    """
    if TASKS.get(task.name, task) != task:
        raise UsageError(f"another task is called {task.name!r}; choose another name.")
    TASKS[task.name] = task


def find_task(task: str | Path | Task) -> Task:
    """Return the task with this name, the task of a problem file, or the task itself.

    Args:
        task: a name in `TASKS`, the path of a problem file (`.yaml`), or a task.

    Raises:
        UsageError: no task has this name (the nearest one is suggested), or it is neither name nor task.
        PlanspaceError: the problem file or its model cannot be read.
    """
    if isinstance(task, Task):
        return task
    if (name := str(getattr(task, "name", task))).startswith(GYM_PREFIX):
        raise UsageError(
            f"{name} is a Gymnasium environment, which has no planning problem: import demonstrations with "
            "`planspace demos import`, fit an embedding with `planspace embed`, and train policies with "
            f"`planspace train {name} --embedding DIR --z augment`."
        )
    if not isinstance(task, str | Path):
        raise UsageError(f"expected a task or its name, got {quoted(task)}. See {PAGE}.")
    if is_problem_file(task):
        from planspace.tasks.problem_file import load_problem
        from planspace.tasks.problem_task import task_of_problem

        return task_of_problem(load_problem(task))
    if str(task) not in TASKS and Path(f"{task}.yaml").is_file():
        raise UsageError(f"unknown task {quoted(str(task))}. Did you mean the problem file {task}.yaml?")
    if str(task) not in TASKS:
        raise unknown("task", str(task), TASKS)
    return TASKS[str(task)]


def is_problem_file(task: str | Path) -> bool:
    """Whether a task is given as the path of a problem file."""
    return str(task).endswith((".yaml", ".yml"))
