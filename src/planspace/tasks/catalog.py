"""The tasks by name: each module in `tasks/shipped` has one, and users can add their own.

A shipped planning problem that no task is named after is a task, too; see `tasks.problem_task`.
"""

import importlib
import pkgutil
from pathlib import Path

from planspace.errors import UsageError, quoted
from planspace.mjcf.assets import ASSETS
from planspace.tasks import shipped
from planspace.tasks.dm_control.suite import DMC_PREFIX, find_dmc_task
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


def task_names() -> list[str]:
    """Return the names that `find_task` takes: those of `TASKS`, and of the problems that can be tasks."""
    kinematic = {path.stem for path in ASSETS.glob("*.yaml") if "kinematic: true" in path.read_text()}
    return sorted({*TASKS, *_problem_names()} - kinematic)


def _problem_names() -> list[str]:
    """The names of the shipped problems, without the imports of `tasks.problem_file`."""
    return [path.stem for path in ASSETS.glob("*.yaml")]


def add_task(task: Task) -> None:
    """Let a task of your own be found by its name in this process.

    Raises:
        UsageError: another task has this name.
    """
    if TASKS.get(task.name, task) != task:
        raise UsageError(f"another task is called {task.name!r}; choose another name.")
    TASKS[task.name] = task


def find_task(task: str | Path | Task) -> Task:
    """Return the task with this name, the task of a problem, or the task itself.

    Args:
        task: a name in `task_names()`, a task of DeepMind Control such as `dmc:acrobot-swingup`, the path of
            a problem file (`.yaml`), or a task. A name of both a task and a shipped problem means the task.

    Raises:
        UsageError: no task has this name (the nearest one is suggested), it is neither name nor task, or
            the problem is kinematic.
        PlanspaceError: the problem file or its model cannot be read, or dm_control is not installed.
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
    name = str(task)
    if name in TASKS:
        return TASKS[name]
    if name.startswith(DMC_PREFIX):
        return find_dmc_task(name)
    from planspace.tasks.problem_file import load_problem, unknown_name

    if is_problem_file(task) or name in _problem_names():
        from planspace.tasks.problem_task import task_of_problem

        return task_of_problem(load_problem(task))
    raise unknown_name("task", name, task_names())


def is_problem_file(task: str | Path) -> bool:
    """Whether a task is given as the path of a problem file."""
    return str(task).endswith((".yaml", ".yml"))
