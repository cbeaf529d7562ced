"""Text files of numbers: one row per state with the control that is held from that state on.

episode,time,slider,hinge,slidervel,hingevel,control1
0,0.0,-0.18,1.3,0.08,-0.03,2.5
0,0.02,...

`csv_dialect.py` finds the delimiter, the decimal mark and the header.
"""

import csv
import io
import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.formats.columns import EPISODE_NAME, TIME_NAMES
from planspace.demos.formats.csv_dialect import (
    SAMPLE_LINES,
    Dialect,
    explain_cell,
    find_dialect,
    read_number,
)
from planspace.demos.formats.format import Format, Table, Tables
from planspace.demos.guess import split_unit
from planspace.demos.recording import ImportOptions, check_options, source_name
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, quoted
from planspace.storage.checks import check_file, explain_read
from planspace.storage.files import write_bytes

MAX_LINE = 1 << 24
"""Longest line that is read [characters]; a longer one does not belong to a table."""
PART_ROWS = 4096
"""Number of rows that are converted at a time."""
SUFFIXES = (".csv", ".tsv")


def read_csv(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Tables:
    """Read CSV files: one demonstration per file, or one per value of the column `episode`.

    Args:
        sources: at least one file, in the order of the demonstrations.
        info: not used; see `planspace.demos.tables`.
        options: `filter_key` cannot be used.

    Raises:
        PlanspaceError: a file is not UTF-8 text, a row has too few cells, or a cell is not a finite number;
            the message names the file, line and column. Rows are read, and these errors are raised, while the
            caller iterates over the rows.
    """
    check_options(options, source_name(sources), "state", "control", "dt", "time", "episode")
    files = [(Path(source), _find_dialect(Path(source))) for source in sources]
    notices = dict.fromkeys(notice for _, dialect in files for notice in dialect.notices)
    return Tables([_table(file, dialect) for file, dialect in files], notices=tuple(notices))


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
class _TextRows:
    """Rows of a file as text."""

    file: Path
    dialect: Dialect
    lines: Int[np.ndarray, " row"]
    cells: list[list[str]]

    def numbers(self, columns: Sequence[int]) -> Float[np.ndarray, "row column"]:
        """The numbers in some columns; NaN where a cell is empty."""
        texts = [row[column] for row in self.cells for column in columns]
        shape = (len(self.cells), len(columns))
        try:
            values = None if self.dialect.decimal_comma else np.fromiter(map(float, texts), float, len(texts))
        except ValueError:
            values = None
        if values is None or not np.isfinite(values).all() or "_" in "".join(texts):
            values = np.array([self._number(i, texts[i], columns) for i in range(len(texts))])
        return values.reshape(shape)

    def labels(self, column: int) -> list[str]:
        """The cells of a column without white space around them."""
        return [row[column].strip() for row in self.cells]

    def _number(self, i: int, cell: str, columns: Sequence[int]) -> float:
        """The i-th cell, counted along the rows of the chosen columns."""
        if not cell or cell.isspace():
            return np.nan
        try:
            return read_number(cell, self.dialect.decimal_comma)
        except ValueError:
            row, column = divmod(i, len(columns))
            name = self.dialect.header[columns[column]]
            wrong = explain_cell(cell, self.dialect)
            raise PlanspaceError(
                f"{self.file}, line {self.lines[row]}: column {quoted(name)} {wrong}. Correct it, or leave "
                f"the column out with --drop {quoted(name)}."
            ) from None


def _find_dialect(file: Path) -> Dialect:
    with _opened(file) as lines:
        return find_dialect(list(itertools.islice(lines, SAMPLE_LINES)), str(file))


def _table(file: Path, dialect: Dialect) -> Table:
    columns = tuple(map(split_unit, dialect.header))
    return Table(str(file), columns, lambda: _parts(file, dialect), "line")


def _parts(file: Path, dialect: Dialect) -> Iterator[_TextRows]:
    size, found, first = len(dialect.header), False, "header" if dialect.has_header else "first row"
    with _opened(file) as lines:
        rows = itertools.islice(dialect.rows(lines), int(dialect.has_header), None)
        while part := list(itertools.islice(rows, PART_ROWS)):
            for line, cells in part:
                if len(cells) != size:
                    raise PlanspaceError(
                        f"{file}, line {line} has {len(cells)} cells, but the {first} has {size}."
                    )
            yield _TextRows(file, dialect, np.array([line for line, _ in part]), [cells for _, cells in part])
            found = True
    if not found:
        raise PlanspaceError(f"{file} changed while it was being read.")


@contextmanager
def _opened(file: Path) -> Iterator[Iterator[str]]:
    """The lines of a text file."""
    check_file(file, may_be_link=True)
    try:
        with explain_read(file), open(file, encoding="utf-8-sig", newline="") as text:
            yield _lines(text, file)
    except UnicodeDecodeError as error:
        raise PlanspaceError(
            f"{file} is not UTF-8 text ({error.reason}); save it as CSV with the encoding UTF-8."
        ) from error
    except csv.Error as error:
        raise PlanspaceError(f"{file} is not a CSV file ({error}).") from error


def _lines(text: TextIO, file: Path) -> Iterator[str]:
    while line := text.readline(MAX_LINE):
        if len(line) == MAX_LINE:
            raise PlanspaceError(f"{file} is not a CSV file (a line has more than {MAX_LINE} characters).")
        yield line


CSV = Format("FILE.csv", lambda source: Path(source).suffix.lower() in SUFFIXES, read_csv, write_csv)
