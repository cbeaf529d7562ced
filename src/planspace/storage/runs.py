"""Run folders: their settings and their lock."""

import contextlib
import errno
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from planspace.errors import PlanspaceError
from planspace.storage.checks import CONFIG, explain_write
from planspace.storage.files import TEMPORARY_PREFIX, make_folder
from planspace.storage.json_files import read_json, write_json
from planspace.storage.settings import list_differences, update_settings

NOTHING: Mapping[str, Any] = MappingProxyType({})
LOCK = f"{TEMPORARY_PREFIX}lock"
"""The file that is locked; like other temporary files, it is no part of a folder's content."""
WITHOUT_LOCKS = {errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK}
"""Errors of file systems that cannot lock. Commands then work without a lock."""


def open_run(
    path: Path,
    config: Mapping[str, Any],
    *,
    renamed: Mapping[str, str] = NOTHING,
    added: Mapping[str, Any] = NOTHING,
    update: Callable[[dict[str, Any]], Mapping[str, Any]] = dict,
) -> Path:
    """Open a run folder, to start a run or to continue it.

    Args:
        path: the folder.
        config: the resolved settings as plain data; saved as `config.json`.
        renamed: old names of settings to today's, so that runs of earlier versions can be continued; see
            `update_settings`.
        added: settings that earlier versions did not have, and the value that reproduces what they did.
        update: converts saved settings of earlier versions, for changes that the two tables cannot express.

    Returns:
        The folder.

    Raises:
        PlanspaceError: the folder cannot be written, is not a run, or was made with other settings (the
            message lists each difference).
    """
    make_folder(path)
    saved = path / CONFIG
    config = json.loads(json.dumps(config))
    if not saved.exists():
        refuse_other_files(path, "planspace run", f"{re.escape(TEMPORARY_PREFIX)}.*")
        write_json(saved, config)
        return path
    before = update(update_settings(read_json(saved), renamed=renamed, added=added))
    changed = list(list_differences(before, config))
    if changed:
        raise PlanspaceError(
            f"{path} was made with other settings: {'; '.join(changed)}. "
            "Choose another --out, or give the same settings to continue it."
        )
    return path


def refuse_other_files(path: Path, kind: str, own: str) -> None:
    """Refuse to begin in a folder that holds files of someone else.

    Args:
        path: the folder.
        kind: what the folder would be, for the message.
        own: regular expression of the names that an interrupted command may have left.

    Raises:
        PlanspaceError: it holds another name.
    """
    if others := sorted(file.name for file in path.iterdir() if not re.fullmatch(own, file.name)):
        raise PlanspaceError(
            f"{path} is not empty and is not a {kind} (it holds {others[0]!r}); choose another --out."
        )


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Make a folder, and reserve it for this process inside the block. The end of the process releases it.

    Raises:
        PlanspaceError: another process has reserved it, or it cannot be written.
    """
    import filelock

    file = make_folder(folder) / LOCK
    lock = filelock.FileLock(file)
    with explain_write(folder):
        try:
            lock.acquire(blocking=False)
        except filelock.Timeout:
            raise PlanspaceError(
                f"{folder} is in use by another planspace process{_holder(file)}; wait for it, or choose "
                "another --out."
            ) from None
        except OSError as error:
            if error.errno not in WITHOUT_LOCKS:
                raise
    try:
        if lock.is_locked:
            with contextlib.suppress(OSError):
                file.write_text(str(os.getpid()))  # for the message above
        yield
    finally:
        if lock.is_locked:
            with contextlib.suppress(OSError):  # Windows removes no open file
                file.unlink()
        lock.release()


def _holder(lock: Path) -> str:
    """The process that holds a lock, if it can be read."""
    with contextlib.suppress(OSError, ValueError):
        return f" (pid {int(lock.read_bytes()[:20])})"
    return ""
