"""Atomic, durable writes and checked reads of files and folders.

A file is written under a temporary name in the same folder, flushed to disk and renamed, and the folder is
flushed too. A crash at any moment therefore leaves the old file or the new one.
"""

import contextlib
import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

from planspace.errors import PlanspaceError
from planspace.storage.checks import MAX_BYTES, check_file, explain_read, explain_write

TEMPORARY_PREFIX = ".writing-"
MIN_LINKED_BYTES = 1 << 16
"""Smaller files are never hard links: someone may edit them in place, which would change every link."""


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically: a crash leaves the old content or the new, never a part.

    Raises:
        PlanspaceError: the file cannot be written; its old content is intact.
    """
    temporary = path.parent / f"{TEMPORARY_PREFIX}{path.name}-{os.getpid()}"
    with explain_write(path):
        try:
            with open(temporary, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
            sync_folder(path.parent)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def write_or_link(path: Path, data: bytes, same: Iterable[Path]) -> None:
    """Write a file; store a large one only once if another file has the same content.

    The new file is then a hard link to the other one. This is safe, because files are replaced and never
    changed in place. On file systems without hard links it is a copy.

    Args:
        path: the file.
        data: its content.
        same: files that may have the same content. They need not exist.

    Raises:
        PlanspaceError: the file cannot be written.
    """
    if len(data) < MIN_LINKED_BYTES or not any(_link(path, data, other) for other in same):
        write_bytes(path, data)


def _link(path: Path, data: bytes, other: Path) -> bool:
    """Whether a file could be made as a hard link to another one."""
    with contextlib.suppress(OSError):
        if other.is_file() and other.stat().st_size == len(data) and other.read_bytes() == data:
            os.link(other, path, follow_symlinks=False)
            sync_folder(path.parent)
            return True
    return False


def read_bytes(path: Path, *, most: int = MAX_BYTES, may_be_link: bool = False) -> bytes:
    """Read a whole file.

    Args:
        path: the file.
        most: largest allowed size in bytes.
        may_be_link: whether the file may be a link out of its folder; see `check_file`.

    Raises:
        PlanspaceError: the file is missing or unreadable, or `check_file` rejects it.
    """
    check_file(path, most=most, may_be_link=may_be_link)
    with explain_read(path):
        return path.read_bytes()


def file_hash(path: Path) -> str:
    """Compute the SHA-256 of a file's bytes.

    Raises:
        PlanspaceError: the file is missing or unreadable.
    """
    check_file(path, may_be_link=True)
    with explain_read(path), open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove_file(path: Path) -> None:
    """Remove a file if it exists.

    Raises:
        PlanspaceError: the file cannot be removed.
    """
    with explain_write(path):
        path.unlink(missing_ok=True)


def rename_file(file: Path, to: Path) -> None:
    """Rename a file within its folder.

    Raises:
        PlanspaceError: the file cannot be renamed.
    """
    with explain_write(to):
        os.replace(file, to)
        sync_folder(file.parent)


def make_folder(path: Path) -> Path:
    """Make a folder and its parents, and check that files can be written in it.

    Raises:
        PlanspaceError: the folder cannot be made or written.
    """
    if path.is_file():
        raise PlanspaceError(f"{path} is a file, and a folder is needed; choose another path.")
    with explain_write(path):
        missing = [folder for folder in (path, *path.parents) if not folder.exists()]
        path.mkdir(parents=True, exist_ok=True)
        for folder in missing:
            sync_folder(folder.parent)
        probe = path / f"{TEMPORARY_PREFIX}probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    return path


def sync_folder(path: Path) -> None:
    """Flush a folder to disk, so that new and renamed files in it survive a power failure."""
    if os.name == "nt":  # Windows cannot open a folder to flush it
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
