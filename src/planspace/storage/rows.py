"""Logs with one JSON object per line (`log.jsonl`)."""

import errno
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from planspace.storage.checks import explain_write
from planspace.storage.files import read_bytes, sync_folder


def append_rows(path: Path, rows: Sequence[Mapping[str, Any]], *, key: str) -> None:
    """Append rows to a log and flush it. On a full disk, none of them is appended.

    A row that the log already holds is not appended again: if a run stops after writing a row and before
    saving the checkpoint that counts it, the continued run computes the same row once more.

    Args:
        path: the log.
        rows: at least one row, in the order of their numbers.
        key: key of a row's number, for example `"step"`. Numbers increase from row to row.

    Raises:
        PlanspaceError: the log cannot be written, or `check_file` rejects it.
    """
    with explain_write(path):
        is_new = not os.path.lexists(path)
        complete = b"" if is_new else _complete_lines(path)
        known = _numbers_from(rows[0][key], complete, key)
        lines = b"".join((json.dumps(row) + "\n").encode() for row in rows if row[key] not in known)
        try:
            with open(path, "ab", buffering=0) as file:
                if file.write(lines) != len(lines):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(file.fileno())  # even without new lines: an interrupt may have skipped it before
        except OSError:
            if path.exists():
                os.truncate(path, len(complete))
            raise
        if is_new:
            sync_folder(path.parent)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Read all rows of a log.

    Raises:
        PlanspaceError: `check_file` rejects the log.
        ValueError: a line is not JSON; callers reject the file as malformed.
    """
    return [json.loads(line) for line in read_bytes(path).splitlines()]


def is_row(line: bytes) -> bool:
    """Whether a line of a log is a JSON object."""
    try:
        return isinstance(json.loads(line), dict)
    except (ValueError, RecursionError):
        return False


def _complete_lines(path: Path) -> bytes:
    """Read a log after removing a last line that a crash left incomplete."""
    data = read_bytes(path)
    complete = data[: data.rfind(b"\n") + 1]
    if len(complete) < len(data):
        os.truncate(path, len(complete))
    return complete


def _numbers_from(first: int, log: bytes, key: str) -> set[int]:
    """Numbers of the last rows of a log, back to the first that is below `first`."""
    found: set[int] = set()
    for line in reversed(log.splitlines()):
        number = json.loads(line).get(key) if is_row(line) else None
        if isinstance(number, int):
            if number < first:
                break
            found.add(number)
    return found
