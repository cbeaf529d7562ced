"""Read the log of an embedding's training."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NotRequired, TypedDict

from planspace.embed.saved_embedding import LOG
from planspace.errors import PlanspaceError
from planspace.storage.files import read_bytes


class LogRow(TypedDict):
    """One row of a training log. Each list has one number per seed."""

    step: int
    """Optimiser steps so far."""
    path_error: NotRequired[Sequence[float | None]]
    """Path error on the training demonstrations; None if there is only one."""
    bound: NotRequired[list[float]]
    """Mean value of the objective per triplet [nats]."""


def read_log(folder: Path) -> list[LogRow]:
    """Read the rows of a training log, sorted by step.

    If a step appears twice, the later row is used. An incomplete last line, left by a crash, is ignored.

    Args:
        folder: the folder of an embedding, which contains log.jsonl.

    Raises:
        PlanspaceError: the log does not exist, or a line before the last one is damaged.
    """
    path = folder / LOG
    lines = read_bytes(path).decode(errors="replace").splitlines()
    rows: dict[int, LogRow] = {}
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
            rows[int(row["step"])] = row
        except (ValueError, KeyError, TypeError) as error:
            if number == len(lines):
                break
            raise PlanspaceError(
                f"{path}, line {number} is damaged ({error}); `planspace repair {folder}` removes the line."
            ) from error
    return [rows[step] for step in sorted(rows)]
