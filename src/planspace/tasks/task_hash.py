"""The content hash of a task."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from planspace.storage.json_files import json_hash
from planspace.tasks.gymnasium import AnyTask
from planspace.tasks.source_hash import file_settings, function_settings
from planspace.tasks.task import Task


def task_hash(task: Task, describe_path: Callable[[Path], Any] = file_settings) -> str:
    """SHA-256 of model, numbers and the source of the functions; see `Task.hash`."""
    names = [f.name for f in fields(task) if f.name not in ("model", "problem")]
    settings = {name: function_settings(getattr(task, name), describe_path=describe_path) for name in names}
    for name, default in (("draw_starts", None), ("action_repeat", 1)):  # earlier versions had neither
        if getattr(task, name) == default:
            del settings[name]
    source = task.source
    settings["problem"] = task.problem_name
    return json_hash({**settings, "model": source.text if source.is_text else source.plain()})


def earlier_hash(task: Task) -> str:
    """The hash that earlier versions recorded: files that a function reads count by their paths."""
    return task_hash(task, str)


def with_todays_hash(saved: Mapping[str, Any], task: AnyTask) -> dict[str, Any]:
    """Saved settings of a run; a hash of its task that an earlier version recorded becomes today's."""
    if isinstance(task, Task) and saved.get("task_sha256") == earlier_hash(task):
        return {**saved, "task_sha256": task.hash}
    return dict(saved)
