"""Checks of files before they are read, and errors for files that cannot be read or written.

A file is read only if it is a regular file of a bounded size that lies inside its own folder; see
`check_file`.
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
"""The settings of a run; see `planspace.storage.runs.open_run`."""
RUN_FILES = (CONFIG, "policies.json")
"""Every run folder holds at least one of these."""
PART_OF_RUN = re.compile(r"checkpoint|embedding(-\d+)?")
"""Names of the folders inside a run folder that belong to the run."""
MAX_JSON_BYTES = 1 << 28
"""Upper bound for a JSON file: neither the manifest of a million shards nor a large model is larger."""


def _memory_bytes() -> int:
    """Memory that this process may use: the machine's, or the limit of its container if that is lower."""
    try:
        available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows
        return sys.maxsize
    with contextlib.suppress(OSError, ValueError):  # no container, or one without a limit
        available = min(available, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return available


MAX_BYTES = _memory_bytes() // 4
"""Upper bound for a file that is read at once: checking and concatenating its arrays takes copies."""


def check_file(path: Path, *, most: int = sys.maxsize, may_be_link: bool = False) -> None:
    """Check that a file may be opened. Reading a pipe or device may never end; a link may point anywhere.

    Args:
        path: the file.
        most: largest allowed size in bytes; by default any, for files that are read piece by piece.
        may_be_link: whether the file may be a link out of its folder. Set it for a path that the user gave.
            Files that belong to one of our folders must lie in that folder; the folder may be a link.

    Raises:
        PlanspaceError: the file is missing, not a regular file, too large, or a link out of its folder.
    """
    if not may_be_link:
        _refuse_link_out(path)
        run = path.parent.parent
        if PART_OF_RUN.fullmatch(path.parent.name) and any((run / name).exists() for name in RUN_FILES):
            _refuse_link_out(path.parent)
    with explain_read(path):
        status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise PlanspaceError(f"cannot read {path}: it is not a regular file.")
    if status.st_size > most:
        raise PlanspaceError(f"{path} has {status.st_size} bytes; at most {most} can be read here.")


def _refuse_link_out(path: Path) -> None:
    target, folder = os.path.realpath(path), path.parent
    if not Path(target).is_relative_to(os.path.realpath(folder)):
        raise PlanspaceError(f"{path} is a link out of its folder, to {target}; replace it with a copy.")


def damage_error(path: Path, what: str) -> PlanspaceError:
    """Build the error for a file whose content is not what planspace wrote.

    Args:
        path: the file.
        what: what is wrong with it.
    """
    return PlanspaceError(
        f"{path} was altered or damaged: {what}. Restore it from a copy; or run `planspace repair "
        f"{path.parent}`, which sets it aside, and then the command that made it."
    )


@contextlib.contextmanager
def reject_malformed(path: Path) -> Iterator[None]:
    """Turn the exceptions that malformed content causes into an error that names the file.

    Raises:
        PlanspaceError: a value in the file is missing or has the wrong type, size or range, or the file does
            not fit into memory.
    """
    try:
        with explain_memory_error(path):
            yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        text = " ".join(str(error).split())[:200]
        raise damage_error(path, f"its content is invalid ({type(error).__name__}: {text})") from error


@contextlib.contextmanager
def explain_read(path: Path) -> Iterator[None]:
    """Turn an OSError while reading into an error that names the file.

    Raises:
        PlanspaceError: the file cannot be read.
    """
    try:
        with explain_memory_error(path):
            yield
    except OSError as error:
        raise PlanspaceError(f"cannot read {path}: {error.strerror or error}.") from error


@contextlib.contextmanager
def explain_library_read(path: Path, kind: str, longest: int | None = None) -> Iterator[None]:
    """Turn what a library raises while it reads a file into an error of one line that names the file.

    Args:
        path: the file.
        kind: its format, for the message.
        longest: number of characters of the library's message to keep; all by default.

    Raises:
        PlanspaceError: the file cannot be read, or it is damaged.
    """
    try:
        with explain_read(path):
            yield
    except PlanspaceError as error:
        if isinstance(error.__cause__, OSError):  # the message of a library can have several lines
            raise PlanspaceError(" ".join(str(error).split())) from error
        raise
    except (LookupError, TypeError, ValueError, RuntimeError, AttributeError, ArithmeticError) as error:
        text = " ".join(str(error).split())[:longest] or type(error).__name__
        raise PlanspaceError(f"{path} is not a readable {kind} file ({text}).") from error


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
            "free some space or choose another --out, and run the same command again."
        ) from error


@contextlib.contextmanager
def explain_memory_error(path: Path | str) -> Iterator[None]:
    """Turn a MemoryError into an error that names the file.

    Raises:
        PlanspaceError: the file does not fit into memory.
    """
    try:
        yield
    except MemoryError as error:
        raise PlanspaceError(f"not enough memory to read {path}.") from error
