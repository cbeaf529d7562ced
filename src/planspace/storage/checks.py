"""Checks of files before they are read, and the errors for files that cannot be read or written.

A file that is read must be a regular file of a bounded size, inside its own folder; see `check_file`.
"""

import contextlib
import os
import re
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

from planspace.errors import PlanspaceError

CONFIG = "config.json"
"""The settings a run was started with; see `open_run`."""
RUN_FILES = (CONFIG, "policies.json")
"""One of these lies in every run's folder."""
PART_OF_RUN = re.compile(r"checkpoint|embedding(-\d+)?")
"""Folders in a run's that are part of it."""
MAX_JSON_BYTES = 1 << 28
"""No description is larger: neither a manifest of a million shards nor a model with all its meshes."""


def _memory_bytes() -> int:
    """What this process may use: all of the machine's memory, or what its container is given."""
    try:
        most = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows
        return sys.maxsize
    with contextlib.suppress(OSError, ValueError):  # no container, or one without a limit
        most = min(most, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return most


MAX_BYTES = _memory_bytes() // 4
"""What is read in one piece is no larger: its parts are copied while they are checked and laid end to end."""


def check_file(path: Path, *, most: int = sys.maxsize, may_be_link: bool = False) -> None:
    """Refuses what is not to be opened: a pipe or a device would never end, a link may lead anywhere.

    Args:
        path: the file.
        most: how many bytes it may have; any number where it is read piece by piece.
        may_be_link: whether it may be a link to a file elsewhere, as what the user names himself may be. What
            belongs to a folder of ours must lie in it; the folder itself may be a link.

    Raises:
        PlanspaceError: it is missing, no plain file, too large, or a link out of its folder.
    """
    if not may_be_link:
        _refuse_link_out(path)
        run = path.parent.parent
        if PART_OF_RUN.fullmatch(path.parent.name) and any((run / name).exists() for name in RUN_FILES):
            _refuse_link_out(path.parent)
    with explain_read(path):
        status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise PlanspaceError(f"cannot read {path}: it is no plain file.")
    if status.st_size > most:
        raise PlanspaceError(f"{path} has {status.st_size} bytes; at most {most} can be read here.")


def _refuse_link_out(path: Path) -> None:
    target, folder = os.path.realpath(path), path.parent
    if not Path(target).is_relative_to(os.path.realpath(folder)):
        raise PlanspaceError(f"{path} is a link out of its folder, to {target}; put a copy in its place.")


def damage_error(path: Path, what: str) -> PlanspaceError:
    """Builds the error for a file that is not what was written."""
    return PlanspaceError(
        f"{path} was altered or damaged: {what}. Restore it from a copy; or `planspace repair "
        f"{path.parent}` sets it aside, and the command that made it makes it again."
    )


@contextlib.contextmanager
def reject_malformed(path: Path) -> Iterator[None]:
    """Turns what a file that makes no sense leads to into an error that names the file.

    Raises:
        PlanspaceError: something in it is missing, or of another kind, size or range than it should be; or
            there is no memory for it.
    """
    try:
        with explain_memory_error(path):
            yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        text = " ".join(str(error).split())[:200]
        raise damage_error(path, f"it makes no sense ({type(error).__name__}: {text})") from error


@contextlib.contextmanager
def explain_read(path: Path) -> Iterator[None]:
    """Turns what the operating system says of a file that cannot be read into our error.

    Raises:
        PlanspaceError: it cannot be read.
    """
    try:
        with explain_memory_error(path):
            yield
    except OSError as error:
        raise PlanspaceError(f"cannot read {path}: {error.strerror or error}.") from error


@contextlib.contextmanager
def explain_write(path: Path) -> Iterator[None]:
    """Turn an OSError while writing into an error that names the file.

    Raises:
        PlanspaceError: the file cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise PlanspaceError(
            f"cannot write {path}: {error.strerror}. What was saved before is intact; "
            "make room or choose another --out, and run the same command again."
        ) from error


@contextlib.contextmanager
def explain_memory_error(path: Path | str) -> Iterator[None]:
    """Turns a lack of memory into an error that names the file it was wanted for.

    Raises:
        PlanspaceError: there is not enough.
    """
    try:
        yield
    except MemoryError as error:
        raise PlanspaceError(f"there is not enough memory to read {path}.") from error
