"""The two layouts in which the 2020 study kept its plans.

`.out`: what OMPL's `printAsMatrix` writes. A row of numbers for each state: the state, then the control and
the duration [s] of the edge that led to it; those of the first row lead from nowhere and are passed over.
A control is held for its whole duration, several steps of the model.

`.json`: such a plan rolled out step by step. `{"state_dims": [names ..., "control1" ..., "time"], "path":
[[row], ...]}`, written with a comma behind the last element of a list. The control of a row is held from it
on, as replaying the released plans confirms. `time` is read as the moment of the row, counted from 0, if
that is what it looks like in most of the files; otherwise as a duration, of the edge leading to the row
where the first row's is 0, and of the row's own control where it is not.

Angles stay as recorded: the released plans wind their pole, and are compared with as they are.
"""

import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.columns import NO_CONTROLS, Columns, choose_columns
from planspace.demos.dataset import Episode, StateInfo
from planspace.demos.recording import Imported, ImportOptions, check_rising, finite_number, recorded
from planspace.errors import PlanspaceError, UsageError, quoted
from planspace.storage.checks import MAX_JSON_BYTES
from planspace.storage.files import read_bytes

TRAILING_COMMA = re.compile(r'"(?:[^"\\]|\\.)*+"?|[\[{]\s*,|,(?=\s*[\]}])', re.DOTALL)
"""Texts and a comma that opens a list are matched so as to be passed over; a text without an end goes to the
file's, or each quotation mark in it would be tried as the beginning of one."""

LARGEST = sys.float_info.max


def read_out_paths(files: Sequence[Path], info: StateInfo | None) -> Imported:
    """Reads plans as OMPL prints them, one a file: a state at the end of each edge.

    Args:
        files: the files, in the order of the demonstrations.
        info: the problem's states, in the order of the rows.

    Raises:
        UsageError: there is no problem to say how many numbers are state.
        PlanspaceError: a row is not n numbers of state, m of control and a duration (its line is named).
    """
    if info is None:
        raise UsageError("an .out file does not say which of its numbers are the state; give --problem.")
    return Imported(info, [_out_episode(file, info, i) for i, file in enumerate(files)], keep_angles=True)


def read_json_paths(files: Sequence[Path], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Reads rolled-out plans, one a file.

    Args:
        files: the files, in the order of the demonstrations.
        info: the problem's states, if there is a problem; its names are looked for in `state_dims`.
        options: which of the columns to take.

    Raises:
        PlanspaceError: the file is not of this layout, or a number is missing (file and row are named).
    """
    tables = [_json_table(file) for file in files]
    columns = [
        choose_columns(header, info, options, str(file))
        for file, (header, _) in zip(files, tables, strict=True)
    ]
    for file, chosen in zip(files, columns, strict=True):
        if chosen.time is None:
            raise PlanspaceError(f"{file} has no 'time' among its state_dims.")
        if chosen.info != columns[0].info:
            raise PlanspaceError(f"{file} has other state_dims than {files[0]}; all plans need the same.")
    clocks = [rows[:, c.time] for c, (_, rows) in zip(columns, tables, strict=True)]
    are_moments = sum(_looks_like_moments(clock) for clock in clocks) > len(clocks) / 2
    episodes = [
        _json_episode(file, rows, chosen, are_moments, i)
        for i, (file, (_, rows), chosen) in enumerate(zip(files, tables, columns, strict=True))
    ]
    notices = () if columns[0].controls else (NO_CONTROLS,)
    return Imported(columns[0].info, episodes, notices, keep_angles=True)


def _out_episode(file: Path, info: StateInfo, index: int) -> Episode:
    n, m = len(info.names), info.num_controls
    rows: list[list[float]] = []
    lines: list[int] = []
    for line, text in enumerate(_text(file).splitlines(), start=1):
        cells = text.split()
        if not cells:
            continue
        place = f"{file}, line {line}"
        if len(cells) != n + m + 1 and (rows or len(cells) != n):
            raise PlanspaceError(
                f"{place} has {len(cells)} numbers; {n} of state, {m} of control and a duration are needed."
            )
        rows.append(_floats(cells, place) + [0.0] * (n + m + 1 - len(cells)))
        lines.append(line)
    if len(rows) < 2:
        raise PlanspaceError(f"{file} has {len(rows)} states; a demonstration needs at least two.")
    matrix = np.array(rows)
    return _from_durations(
        matrix[:, :n], matrix[1:, n:-1], matrix[1:, -1], lambda i: f"{file}, line {lines[i]}", index
    )


def _json_episode(
    file: Path, rows: Float[np.ndarray, "row column"], columns: Columns, are_moments: bool, index: int
) -> Episode:
    def place(row: int) -> str:
        return f"{file}, row {row} of its path"

    states, clock = rows[:, list(columns.states)], rows[:, columns.time]
    controls = rows[:, list(columns.controls)]
    if not columns.controls:
        controls = np.zeros((len(rows), columns.info.num_controls))
    if are_moments:
        check_rising(clock, place)
        return recorded(states, controls[:-1], clock, index)
    if clock[0] == 0.0:
        return _from_durations(states, controls[1:], clock[1:], place, index)
    return _from_durations(states, controls[:-1], clock[:-1], place, index)


def _from_durations(
    states: np.ndarray, controls: np.ndarray, durations: np.ndarray, place: Callable[[int], str], index: int
) -> Episode:
    times = np.concatenate([[0.0], np.cumsum(durations)])
    check_rising(times, place)
    return recorded(states, controls, times, index)


def _looks_like_moments(clock: Float[np.ndarray, " row"]) -> bool:
    return bool(clock[0] == 0.0 and (np.diff(clock) > 0).all())


def _json_table(file: Path) -> tuple[list[str], Float[np.ndarray, "row column"]]:
    value = _read_json(file)
    header, path = value.get("state_dims"), value.get("path")
    if not isinstance(header, list) or not all(isinstance(name, str) for name in header):
        raise PlanspaceError(f"{file} has no list of names 'state_dims'.")
    if not isinstance(path, list) or len(path) < 2:
        raise PlanspaceError(f"{file} has no list 'path' of at least two rows.")
    for i, row in enumerate(path):
        place = f"{file}, row {i} of its path"
        if not isinstance(row, list) or len(row) != len(header):
            size = len(row) if isinstance(row, list) else "no"
            raise PlanspaceError(f"{place} has {size} numbers; state_dims names {len(header)}.")
        _check_numbers(row, place)
    return header, np.array(path, dtype=float)


def _read_json(file: Path) -> dict[str, Any]:
    """The object in a file that is JSON but for commas behind last elements."""
    strict = TRAILING_COMMA.sub(lambda match: " " if match[0] == "," else match[0], _text(file))
    try:
        value = json.loads(strict, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise PlanspaceError(f"{file} is not valid JSON ({error}).") from error
    if not isinstance(value, dict):
        raise PlanspaceError(f"{file} should hold a JSON object, got a {type(value).__name__}.")
    return value


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON number")


def _floats(cells: Sequence[str], place: str) -> list[float]:
    numbers = []
    for cell in cells:
        try:
            numbers.append(finite_number(cell))
        except ValueError:
            raise PlanspaceError(f"{place} holds {quoted(cell)}, which is no finite number.") from None
    return numbers


def _check_numbers(row: Sequence[Any], place: str) -> None:
    for cell in row:
        if isinstance(cell, bool) or not isinstance(cell, int | float) or not abs(cell) <= LARGEST:
            raise PlanspaceError(f"{place} holds {quoted(cell)}, which is no finite number.")


def _text(file: Path) -> str:
    try:
        return read_bytes(file, most=MAX_JSON_BYTES, may_be_link=True).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise PlanspaceError(f"{file} is not UTF-8 text ({error}).") from error
