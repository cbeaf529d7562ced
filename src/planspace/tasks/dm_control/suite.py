"""The tasks of DeepMind Control by name, and the model files of the installed dm_control."""

import functools
import importlib
import importlib.util
import pkgutil
from pathlib import Path
from typing import TYPE_CHECKING

from planspace.errors import PlanspaceError, install_command, unknown
from planspace.mjcf.source import ModelSource

if TYPE_CHECKING:
    from planspace.tasks.task import Task

DMC_PREFIX = "dmc:"
"""Start of the name of a task of DeepMind Control."""
COMMON = ("materials", "skybox", "visual")
"""The files that every model of dm_control includes."""
HORIZON = 1000
"""Steps of an episode; dm_control's episodes of these domains all have as many."""


@functools.cache
def dmc_tasks() -> "dict[str, Task]":
    """Make every task of DeepMind Control that planspace has, by its name without the prefix.

    Raises:
        PlanspaceError: dm_control is not installed.
    """
    package = __name__.rpartition(".")[0]
    modules = [m.name for m in pkgutil.iter_modules([str(Path(__file__).parent)])]
    found = [importlib.import_module(f"{package}.{name}") for name in modules]
    tasks = [task for module in found if hasattr(module, "make_tasks") for task in module.make_tasks()]
    return {task.name.removeprefix(DMC_PREFIX): task for task in tasks}


def find_dmc_task(name: str) -> "Task":
    """Return the task with this name, which starts with `dmc:`.

    Raises:
        PlanspaceError: dm_control is not installed.
        UsageError: no task has this name (the nearest one is suggested).
    """
    tasks = dmc_tasks()
    short = name.removeprefix(DMC_PREFIX)
    if short not in tasks:
        raise unknown("task of DeepMind Control", short, sorted(tasks))
    return tasks[short]


def read_suite(name: str) -> str:
    """Read a model file of the installed dm_control, without importing dm_control.

    Args:
        name: the domain, such as `acrobot`.

    Raises:
        PlanspaceError: dm_control is not installed, or the file cannot be read.
    """
    return _read(f"{name}.xml")


def suite_model(text: str) -> ModelSource:
    """Return the model with this MJCF text, and the files that it includes."""
    return ModelSource(text, files=tuple((name, _read(name).encode()) for name in _common_files()))


def _common_files() -> tuple[str, ...]:
    return tuple(f"common/{name}.xml" for name in COMMON)


def _read(name: str) -> str:
    spec = importlib.util.find_spec("dm_control")
    if spec is None or not spec.submodule_search_locations:
        raise PlanspaceError(
            f"tasks of DeepMind Control need the package dm_control: {install_command('robots')}."
        )
    path = Path(spec.submodule_search_locations[0]) / "suite" / name
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise PlanspaceError(f"{path} of dm_control cannot be read: {error.strerror}.") from error
