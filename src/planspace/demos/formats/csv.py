"""CSV files: a header, then one row per state with the control that is held from that state on.

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

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.formats.columns import EPISODE_NAME, NO_CONTROLS, TIME_NAMES, Columns, choose_columns
from planspace.demos.formats.format import Format, has_suffix
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
from planspace.errors import PlanspaceError, quoted
from planspace.storage.checks import check_file, explain_read
from planspace.storage.files import write_bytes

MAX_LINE = 1 << 24
"""Longest line that is read [characters]; a longer one does not belong to a table."""
Row = tuple[int, list[str]]
"""The line number and the cells of a row."""


def read_csv(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read CSV files: one demonstration per file, or one per value of the column `episode`.

    Args:
        sources: at least one file, in the order of the demonstrations.
        info: the states of the planning problem; None if there is no problem.
        options: the columns to use, and `dt` for files without a column `time` or `t`.

    Raises:
        PlanspaceError: a file is not UTF-8 text, a column is missing, a cell is not a finite number, or times
            do not increase; the message names the file, line and column. Rows are read, and these errors are
            raised, while the caller iterates over the episodes.
    """
    check_options(options, source_name(sources), "state", "control", "dt")
    tables = [_open_table(Path(source), info, options) for source in sources]
    first = tables[0].columns.info
    for table in tables:
        found = table.columns.info
        if found != first:
            raise PlanspaceError(
                f"{table.file} has the states ({', '.join(found.names)}) and {found.num_controls} controls, "
                f"but {sources[0]} has ({', '.join(first.names)}) and {first.num_controls}; all files of a "
                "dataset must have the same."
            )
    demonstrations = ((table, rows) for table in tables for rows in table.demonstrations())
    episodes = (_episode(table, rows, options, i) for i, (table, rows) in enumerate(demonstrations))
    has_controls = all(table.columns.controls for table in tables)
    return Imported(first, episodes, () if has_controls else (NO_CONTROLS,))


def write_csv(demos: Demos, target: str) -> Path:
    """Write demonstrations to one CSV file, with all digits; the last row of each has no control.

    Raises:
        PlanspaceError: a state has the name of another column, or the file cannot be written.
    """
    controls = [f"control{i + 1}" for i in range(demos.info.num_controls)]
    for name in demos.info.names:
        if name in (EPISODE_NAME, *TIME_NAMES, *controls):
            raise PlanspaceError(
                f"the state {name!r} has the name of another column of the CSV file; export to FILE.npz."
            )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([EPISODE_NAME, TIME_NAMES[0], *demos.info.names, *controls])
    for i in range(len(demos)):
        e = demos.episode(i)
        held = [*e.controls.tolist(), [""] * len(controls)]  # a float printed by Python reads back exactly
        for time, state, control in zip(e.times.tolist(), e.states.tolist(), held, strict=True):
            writer.writerow([i, time, *state, *control])
    write_bytes(Path(target), text.getvalue().encode())
    return Path(target)


@dataclass(frozen=True)
class _Table:
    """An open file whose header has been read."""

    file: Path
    header: list[str]
    columns: Columns

    def demonstrations(self) -> Iterator[list[Row]]:
        """The rows of each demonstration, read lazily unless rows of different demonstrations are mixed."""
        column, rows = self.columns.episode, self._rows()
        if column is None:
            yield list(rows)
        elif self._is_sorted(column):
            yield from (
                list(group) for _, group in itertools.groupby(rows, lambda row: row[1][column].strip())
            )
        else:
            groups: dict[str, list[Row]] = {}
            for row in rows:
                groups.setdefault(row[1][column].strip(), []).append(row)
            yield from groups.values()

    def _is_sorted(self, column: int) -> bool:
        runs = [name for name, _ in itertools.groupby(cells[column].strip() for _, cells in self._rows())]
        return len(set(runs)) == len(runs)

    def _rows(self) -> Iterator[Row]:
        rows = _rows(self.file)
        next(rows, None)  # the header
        for line, cells in rows:
            if len(cells) != len(self.header):
                raise PlanspaceError(
                    f"{self.file}, line {line} has {len(cells)} cells, but the header has {len(self.header)}."
                )
            yield line, cells


def _open_table(file: Path, info: StateInfo | None, options: ImportOptions) -> _Table:
    first = [cells for _, cells in itertools.islice(_rows(file), 2)]
    if len(first) < 2:
        raise PlanspaceError(f"{file} must have a header and rows of numbers; it has {len(first)} lines.")
    header = [cell.strip() for cell in first[0]]
    return _Table(file, header, choose_columns(header, info, options, str(file)))


def _rows(file: Path) -> Iterator[Row]:
    """The line number and cells of all rows that are not empty."""
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
        raise PlanspaceError(f"{table.file} changed while it was being read.")
    if len(rows) < 2:
        raise PlanspaceError(
            f"{table.file}, line {rows[0][0]} is a demonstration with one state; at least two are needed."
        )
    if columns.time is not None:
        times = _numbers(table, rows, (columns.time,))[:, 0]
        check_rising(times, lambda i: f"{table.file}, line {rows[i][0]}")
    elif options.dt is not None:
        times = np.arange(len(rows)) * options.dt
    else:
        raise PlanspaceError(
            f"{table.file} has no column 'time' or 't'; rename its column, or give --dt SECONDS."
        )
    if columns.controls:
        controls = _numbers(table, rows[:-1], columns.controls)  # the control in the last row is not used
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
                wrong = f"must be a finite number, got {quoted(cell)}" if cell.strip() else "is empty"
                raise PlanspaceError(f"{table.file}, line {line}: column {name} {wrong}.") from None
    return values


CSV = Format("FILE.csv", has_suffix(".csv"), read_csv, write_csv)
