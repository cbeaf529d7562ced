"""Demonstrations from and to CSV: a header, a row for each state, and the control held from that state on.

episode,time,slider,hinge,slidervel,hingevel,control1
0,0.0,-0.18,1.3,0.08,-0.03,2.5
0,0.02,...
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from planspace.demos.columns import EPISODE_NAME, NO_CONTROLS, TIME_NAMES, Columns, choose_columns
from planspace.demos.dataset import Demos, Episode, StateInfo
from planspace.demos.recording import Imported, ImportOptions, check_rising, finite_number, recorded
from planspace.errors import PlanspaceError
from planspace.store import read_bytes


@dataclass(frozen=True)
class _Table:
    """A file's cells as text, each row with the line it ends on."""

    file: Path
    header: list[str]
    rows: list[tuple[int, list[str]]]


def read_csv(files: Sequence[Path], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Reads CSV files: one demonstration a file, or one for each value of the column `episode`.

    Args:
        files: the files, in the order of the demonstrations.
        info: the problem's states, if there is a problem.
        options: which columns to take; `dt` where there is no column `time` (or `t`) [s].

    Raises:
        PlanspaceError: not UTF-8 text, a column is missing, a cell is no finite number, or times do not
            rise (file, line and column are named).
    """
    episodes: list[Episode] = []
    found, first = info, None
    has_controls = True
    for file in files:
        table = _read_table(file)
        columns = choose_columns(table.header, info, options, str(file))
        first = first or columns.info
        if columns.info != first:
            raise PlanspaceError(
                f"{file} has the states ({', '.join(columns.info.names)}) and {columns.info.num_controls} "
                f"controls, {files[0]} has ({', '.join(first.names)}) and {first.num_controls}; all files "
                "of a dataset need the same."
            )
        found = columns.info
        has_controls = has_controls and bool(columns.controls)
        for rows in _by_episode(table, columns):
            episodes.append(_episode(table, rows, columns, options, len(episodes)))
    if found is None or not episodes:
        raise PlanspaceError("there is no CSV file to read.")
    return Imported(found, episodes, () if has_controls else (NO_CONTROLS,))


def csv_text(demos: Demos) -> str:
    """Demonstrations as one CSV text, every number in full; the last row of each has no control.

    Raises:
        PlanspaceError: a state has the name of another column.
    """
    controls = [f"control{i + 1}" for i in range(demos.info.num_controls)]
    for name in demos.info.names:
        if name in (EPISODE_NAME, *TIME_NAMES, *controls):
            raise PlanspaceError(
                f"the state {name!r} would be taken for another column of a CSV file; export to FILE.npz."
            )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([EPISODE_NAME, TIME_NAMES[0], *demos.info.names, *controls])
    for i in range(len(demos)):
        e = demos.episode(i)
        held = [*e.controls.tolist(), [""] * len(controls)]  # Python's text of a float reads back exactly
        for time, state, control in zip(e.times.tolist(), e.states.tolist(), held, strict=True):
            writer.writerow([i, time, *state, *control])
    return text.getvalue()


def _read_table(file: Path) -> _Table:
    try:
        text = read_bytes(file).decode("utf-8-sig")
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except UnicodeDecodeError as error:
        raise PlanspaceError(f"{file} is not UTF-8 text ({error}).") from error
    except csv.Error as error:
        raise PlanspaceError(f"{file} is not a CSV file ({error}).") from error
    if len(rows) < 2:
        raise PlanspaceError(f"{file} needs a header and rows of numbers; it has {len(rows)} lines.")
    header = [cell.strip() for cell in rows[0][1]]
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise PlanspaceError(f"{file}, line {line} has {len(row)} cells; the header has {len(header)}.")
    return _Table(file, header, rows[1:])


def _by_episode(table: _Table, columns: Columns) -> list[list[tuple[int, list[str]]]]:
    if columns.episode is None:
        return [table.rows]
    groups: dict[str, list[tuple[int, list[str]]]] = {}
    for line, row in table.rows:
        groups.setdefault(row[columns.episode].strip(), []).append((line, row))
    return list(groups.values())


def _episode(
    table: _Table, rows: list[tuple[int, list[str]]], columns: Columns, options: ImportOptions, index: int
) -> Episode:
    if len(rows) < 2:
        raise PlanspaceError(
            f"{table.file}, line {rows[0][0]} is a demonstration of one state; two are needed."
        )
    if columns.time is not None:
        times = _numbers(table, rows, (columns.time,))[:, 0]
        check_rising(times, lambda i: f"{table.file}, line {rows[i][0]}")
    elif options.dt is not None:
        times = np.arange(len(rows)) * options.dt
    else:
        raise PlanspaceError(f"{table.file} has no column 'time' or 't'; name it so, or give --dt SECONDS.")
    if columns.controls:
        controls = _numbers(table, rows[:-1], columns.controls)  # the last row's control leads nowhere
    else:
        controls = np.zeros((len(rows) - 1, columns.info.num_controls))
    return recorded(_numbers(table, rows, columns.states), controls, times, index)


def _numbers(
    table: _Table, rows: list[tuple[int, list[str]]], columns: Sequence[int]
) -> Float[np.ndarray, "row column"]:
    values = np.empty((len(rows), len(columns)))
    for i, (line, row) in enumerate(rows):
        for j, column in enumerate(columns):
            try:
                values[i, j] = finite_number(row[column])
            except ValueError:
                cell = (
                    f"holds {row[column]!r}, which is no finite number" if row[column].strip() else "is empty"
                )
                raise PlanspaceError(
                    f"{table.file}, line {line}: column {table.header[column]!r} {cell}."
                ) from None
    return values
