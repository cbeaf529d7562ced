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
    """Appends JSON lines to a log and flushes them; where they do not fit, no part of them is left.

    A row that is there already is not appended again: what comes between a row and the checkpoint that counts
    it (an interrupt, a crash) has the row done once more, and the same.

    Args:
        path: the log.
        rows: in order of their numbers, at least one.
        key: where a row holds its number; numbers rise from row to row.

    Raises:
        PlanspaceError: it cannot be written, or `check_file` refuses it.
    """
    with explain_write(path):
        new = not os.path.lexists(path)
        whole = b"" if new else _whole_lines(path)
        known = _numbers_from(rows[0][key], whole, key)
        lines = b"".join((json.dumps(row) + "\n").encode() for row in rows if row[key] not in known)
        try:
            with open(path, "ab", buffering=0) as file:
                if file.write(lines) != len(lines):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(file.fileno())  # without lines, too: an interrupt may have come before it
        except OSError:
            if path.exists():
                os.truncate(path, len(whole))
            raise
        if new:
            sync_folder(path.parent)


def is_row(line: bytes) -> bool:
    """Whether a line of a log can be read."""
    try:
        return isinstance(json.loads(line), dict)
    except (ValueError, RecursionError):
        return False


def _whole_lines(path: Path) -> bytes:
    """A log's content, once a line at the end that a crash cut off is removed."""
    data = read_bytes(path)
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) < len(data):
        os.truncate(path, len(whole))
    return whole


def _numbers_from(first: int, log: bytes, key: str) -> set[int]:
    """The numbers of the last rows of a log, as far back as they are not below the first."""
    found: set[int] = set()
    for line in reversed(log.splitlines()):
        there = json.loads(line).get(key) if is_row(line) else None
        if isinstance(there, int):
            if there < first:
                break
            found.add(there)
    return found
