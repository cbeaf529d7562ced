"""Demonstrations from and to CSV: a header, a row for each state, and the control held from that state on.

episode,time,slider,hinge,slidervel,hingevel,control1
0,0.0,-0.18,1.3,0.08,-0.03,2.5
0,0.02,...
"""

import csv
import io
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from jaxtyping import Float

from planspace.demos.columns import EPISODE_NAME, NO_CONTROLS, TIME_NAMES, Columns, choose_columns
from planspace.demos.dataset import Demos, Episode, StateInfo
from planspace.demos.recording import Imported, ImportOptions, check_rising, finite_number, recorded
from planspace.errors import PlanspaceError, quoted
from planspace.storage.checks import check_file, explain_read

MAX_LINE = 1 << 24
"""Characters of a line; what has more is no table, and may have no end."""
Row = tuple[int, list[str]]
"""A row's cells as text, and the line it ends on."""


def read_csv(files: Sequence[Path], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Reads CSV files: one demonstration a file, or one for each value of the column `episode`.

    Args:
        files: the files, in the order of the demonstrations.
        info: the problem's states, if there is a problem.
        options: which columns to take; `dt` where there is no column `time` (or `t`) [s].

    Raises:
        PlanspaceError: not UTF-8 text, a column is missing, a cell is no finite number, or times do not
            rise (file, line and column are named); also while the demonstrations are read.
    """
    tables = [_open_table(file, info, options) for file in files]
    if not tables:
        raise PlanspaceError("there is no CSV file to read.")
    first = tables[0].columns.info
    for table in tables:
        found = table.columns.info
        if found != first:
            raise PlanspaceError(
                f"{table.file} has the states ({', '.join(found.names)}) and {found.num_controls} controls, "
                f"{files[0]} has ({', '.join(first.names)}) and {first.num_controls}; all files of a dataset "
                "need the same."
            )
    courses = ((table, rows) for table in tables for rows in table.demonstrations())
    episodes = (_episode(table, rows, options, i) for i, (table, rows) in enumerate(courses))
    has_controls = all(table.columns.controls for table in tables)
    return Imported(first, episodes, () if has_controls else (NO_CONTROLS,))


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


@dataclass(frozen=True)
class _Table:
    """A file of which the header has been read."""

    file: Path
    header: list[str]
    columns: Columns

    def demonstrations(self) -> Iterator[list[Row]]:
        """The rows of each, read as they are asked for unless the file goes back and forth between them."""
        column, rows = self.columns.episode, self._rows()
        if column is None:
            yield list(rows)
        elif self._is_in_order(column):
            yield from (
                list(group) for _, group in itertools.groupby(rows, lambda row: row[1][column].strip())
            )
        else:
            groups: dict[str, list[Row]] = {}
            for row in rows:
                groups.setdefault(row[1][column].strip(), []).append(row)
            yield from groups.values()

    def _is_in_order(self, column: int) -> bool:
        runs = [name for name, _ in itertools.groupby(cells[column].strip() for _, cells in self._rows())]
        return len(set(runs)) == len(runs)

    def _rows(self) -> Iterator[Row]:
        rows = _rows(self.file)
        next(rows, None)  # the header
        for line, cells in rows:
            if len(cells) != len(self.header):
                raise PlanspaceError(
                    f"{self.file}, line {line} has {len(cells)} cells; the header has {len(self.header)}."
                )
            yield line, cells


def _open_table(file: Path, info: StateInfo | None, options: ImportOptions) -> _Table:
    first = [cells for _, cells in itertools.islice(_rows(file), 2)]
    if len(first) < 2:
        raise PlanspaceError(f"{file} needs a header and rows of numbers; it has {len(first)} lines.")
    header = [cell.strip() for cell in first[0]]
    return _Table(file, header, choose_columns(header, info, options, str(file)))


def _rows(file: Path) -> Iterator[Row]:
    """All rows that are not empty."""
    check_file(file, may_be_link=True)
    try:
        with explain_read(file), open(file, encoding="utf-8-sig", newline="") as text:
            reader = csv.reader(_lines(text, file), strict=True)
            for cells in reader:
                if any(cell.strip() for cell in cells):
                    yield reader.line_num, cells
    except UnicodeDecodeError as error:
        raise PlanspaceError(f"{file} is not UTF-8 text ({error.reason}).") from error
    except csv.Error as error:
        raise PlanspaceError(f"{file} is not a CSV file ({error}).") from error


def _lines(text: TextIO, file: Path) -> Iterator[str]:
    while line := text.readline(MAX_LINE):
        if len(line) == MAX_LINE:
            raise PlanspaceError(f"{file} is not a CSV file (a line has more than {MAX_LINE} characters).")
        yield line


def _episode(table: _Table, rows: list[Row], options: ImportOptions, index: int) -> Episode:
    columns = table.columns
    if not rows:
        raise PlanspaceError(f"{table.file} was changed while it was read.")
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


def _numbers(table: _Table, rows: list[Row], columns: Sequence[int]) -> Float[np.ndarray, "row column"]:
    values = np.empty((len(rows), len(columns)))
    for i, (line, row) in enumerate(rows):
        for j, column in enumerate(columns):
            try:
                values[i, j] = finite_number(row[column])
            except ValueError:
                cell, name = row[column], quoted(table.header[column])
                wrong = f"holds {quoted(cell)}, which is no finite number" if cell.strip() else "is empty"
                raise PlanspaceError(f"{table.file}, line {line}: column {name} {wrong}.") from None
    return values
