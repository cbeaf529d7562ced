"""The two file layouts of the plans of the 2020 study.

`.out`: the output of OMPL's `printAsMatrix`. Each row contains a state, and the control and duration [s] of
the edge that leads to it. The control and duration in the first row are not used. A control is held for its
whole duration, which is several steps of the model.

`.json`: the same plan simulated step by step: `{"state_dims": [names ..., "control1" ..., "time"], "path":
[[row], ...]}`. Lists may have a comma after their last element. A control is held from the state in its row
on; replaying the released plans confirms this. `time` is the time of the row, starting at 0, if it increases
from 0 in most of the files. Otherwise it is a duration: of the edge that leads to the row if the first row
has 0, and of the control in the row if it has not.

Angles keep their full turns, because the released plans are studied as recorded.
"""

import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.episode import Episode
from planspace.demos.formats.columns import NO_CONTROLS, Columns, choose_columns
from planspace.demos.formats.format import Column, Format, has_suffix
from planspace.demos.recording import (
    Imported,
    ImportOptions,
    check_options,
    check_rising,
    finite_number,
    recorded,
    source_name,
)
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError, quoted
from planspace.storage.checks import MAX_JSON_BYTES
from planspace.storage.files import read_bytes

TRAILING_COMMA = re.compile(r'"(?:[^"\\]|\\.)*+"?|[\[{]\s*,|,(?=\s*[\]}])', re.DOTALL)
"""Matches commas before a closing bracket, and also strings and commas after an opening bracket, which stay
unchanged. A string without an end extends to the end of the file; otherwise every quotation mark in it would
be tried as the start of a string."""

LARGEST = sys.float_info.max


def read_out_plans(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read plans printed by OMPL, one per file.

    Args:
        sources: the files, in the order of the demonstrations.
        info: the states of the planning problem.
        options: none of them can be used.

    Raises:
        UsageError: `info` is None, so the size of a state is unknown; or an option was given.
        PlanspaceError: a row does not consist of a state, a control and a duration; the message names its
            line.
    """
    check_options(options, source_name(sources))
    if info is None:
        raise UsageError("an .out file does not say which of its numbers are the state; give --problem.")
    episodes = [_out_episode(Path(source), info, i) for i, source in enumerate(sources)]
    return Imported(info, episodes, keep_angles=True)


def read_json_plans(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read simulated plans, one per file.

    Args:
        sources: the files, in the order of the demonstrations.
        info: the states of the planning problem, which are found in `state_dims` by name; None if there is
            no problem.
        options: the columns to use.

    Raises:
        PlanspaceError: a file has another layout, or a number is missing; the message names the file and row.
    """
    check_options(options, source_name(sources), "state", "control")
    files = list(map(Path, sources))
    tables = [_json_table(file) for file in files]
    columns = [
        choose_columns([Column(name) for name in header], info, options, str(file))
        for file, (header, _) in zip(files, tables, strict=True)
    ]
    for file, chosen in zip(files, columns, strict=True):
        if chosen.time is None:
            raise PlanspaceError(f"{file} has no 'time' among its state_dims.")
        if chosen.info != columns[0].info:
            raise PlanspaceError(
                f"{file} and {files[0]} have different state_dims; all plans must have the same."
            )
    clocks = [rows[:, c.time] for c, (_, rows) in zip(columns, tables, strict=True)]
    is_clock = sum(_looks_like_clock(clock) for clock in clocks) > len(clocks) / 2
    episodes = [
        _json_episode(file, rows, chosen, is_clock, i)
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
                f"{place} has {len(cells)} numbers; expected {n} of a state, {m} of a control and a duration."
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
    file: Path, rows: Float[np.ndarray, "row column"], columns: Columns, is_clock: bool, index: int
) -> Episode:
    def place(row: int) -> str:
        return f"{file}, row {row} of path"

    states, clock = rows[:, list(columns.states)], rows[:, columns.time]
    controls = rows[:, list(columns.controls)]
    if not columns.controls:
        controls = np.zeros((len(rows), columns.info.num_controls))
    if is_clock:
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


def _looks_like_clock(clock: Float[np.ndarray, " row"]) -> bool:
    return bool(clock[0] == 0.0 and (np.diff(clock) > 0).all())


def _json_table(file: Path) -> tuple[list[str], Float[np.ndarray, "row column"]]:
    value = _read_json(file)
    header, path = value.get("state_dims"), value.get("path")
    if not isinstance(header, list) or not all(isinstance(name, str) for name in header):
        raise PlanspaceError(f"{file} must have a list of names 'state_dims'.")
    if not isinstance(path, list) or len(path) < 2:
        raise PlanspaceError(f"{file} must have a list 'path' of at least two rows.")
    for i, row in enumerate(path):
        place = f"{file}, row {i} of path"
        if not isinstance(row, list) or len(row) != len(header):
            size = len(row) if isinstance(row, list) else "no"
            raise PlanspaceError(f"{place} has {size} numbers, but state_dims has {len(header)} names.")
        _check_numbers(row, place)
    return header, np.array(path, dtype=float)


def _read_json(file: Path) -> dict[str, Any]:
    """Read a JSON object whose lists may have a comma after the last element."""
    strict = TRAILING_COMMA.sub(lambda match: " " if match[0] == "," else match[0], _text(file))
    try:
        value = json.loads(strict, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise PlanspaceError(f"{file} is not valid JSON ({error}).") from error
    if not isinstance(value, dict):
        raise PlanspaceError(f"{file} must contain a JSON object, got a {type(value).__name__}.")
    return value


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a JSON number")


def _floats(cells: Sequence[str], place: str) -> list[float]:
    numbers = []
    for cell in cells:
        try:
            numbers.append(finite_number(cell))
        except ValueError:
            raise PlanspaceError(f"{place} contains {quoted(cell)}, which is not a finite number.") from None
    return numbers


def _check_numbers(row: Sequence[Any], place: str) -> None:
    for cell in row:
        if isinstance(cell, bool) or not isinstance(cell, int | float) or not abs(cell) <= LARGEST:
            raise PlanspaceError(f"{place} contains {quoted(cell)}, which is not a finite number.")


def _text(file: Path) -> str:
    try:
        return read_bytes(file, most=MAX_JSON_BYTES, may_be_link=True).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise PlanspaceError(f"{file} is not UTF-8 text ({error}).") from error


PLANS_2020_JSON = Format("FILE.json", has_suffix(".json"), read_json_plans)
PLANS_2020_OUT = Format("FILE.out", has_suffix(".out"), read_out_plans)
