"""Run folders: their settings and their lock."""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # Windows has no flock
    fcntl = None

from planspace.errors import PlanspaceError
from planspace.storage.checks import CONFIG, explain_write
from planspace.storage.files import TEMPORARY_PREFIX, make_folder
from planspace.storage.json_files import read_json, write_json


def open_run(path: Path, config: Mapping[str, Any]) -> Path:
    """Opens a run folder, new or to be continued.

    Args:
        path: the folder.
        config: the resolved settings, plain data; kept as `config.json`.

    Returns:
        The folder.

    Raises:
        PlanspaceError: it cannot be written, holds something else, or was made with other settings
            (each difference is named).
    """
    make_folder(path)
    kept = path / CONFIG
    config = json.loads(json.dumps(config))
    if not kept.exists():
        strangers = [p.name for p in path.iterdir() if not p.name.startswith(TEMPORARY_PREFIX)]
        if strangers:
            raise PlanspaceError(
                f"{path} is not empty and is not a planspace run (it holds {sorted(strangers)[0]!r}); "
                "choose another --out."
            )
        write_json(kept, config)
        return path
    changed = list(list_differences(read_json(kept), config))
    if changed:
        raise PlanspaceError(
            f"{path} was made with other settings: {'; '.join(changed)}. "
            "Choose another --out, or give the same settings to continue it."
        )
    return path


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Keeps a folder to this process; a crash gives it up, too.

    Raises:
        PlanspaceError: another process keeps it.
    """
    with explain_write(folder):
        flags = os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0)  # a link's target is not to be made
        descriptor = os.open(folder / f"{TEMPORARY_PREFIX}lock", flags)
    try:
        if fcntl is not None:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise PlanspaceError(
                    f"another command is at work in {folder}; wait for it, or choose another --out."
                ) from error
        yield
    finally:
        os.close(descriptor)


def list_differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Names each value that is not the same in two trees of plain data."""
    for key in sorted(old.keys() | new.keys()):
        before, now = old.get(key), new.get(key)
        if isinstance(before, dict) and isinstance(now, dict):
            yield from list_differences(before, now, f"{prefix}{key}.")
        elif before != now:
            yield f"{prefix}{key} was {before!r}, now {now!r}"
