"""How the numbers of a text file are laid out: delimiter, header, comments and decimal mark.

It is found from the first lines of a file. What is assumed beyond a plain CSV file is reported.
"""

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from planspace.demos.recording import finite_number
from planspace.errors import PlanspaceError, quoted

SAMPLE_LINES = 50
"""Number of lines that are looked at."""
DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "white space"}
"""Delimiters and what they are called, in the order in which they are tried; the last one is any run of
spaces and tabs."""
COMMENT = "#"
DECIMAL_COMMA = re.compile(r"\s*[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?\s*")


@dataclass(frozen=True)
class Dialect:
    """How the rows of a file are written."""

    delimiter: str
    """A key of `DELIMITERS`."""
    header: tuple[str, ...]
    """Names of the columns; `column0`, `column1`, ... if the file has none."""
    has_header: bool
    """Whether the first row has the names."""
    decimal_comma: bool
    """Whether numbers are written as `0,5`."""
    notices: tuple[str, ...]
    """What was assumed, one line each."""

    def rows(self, lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
        """The number of its last line, and the cells, of each row that is not empty; with the header.

        Args:
            lines: the lines of the file.

        Raises:
            csv.Error: a quoted cell has no end.
        """
        reader = _split(_without_comments(lines), self.delimiter, strict=True)
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, cells


def find_dialect(lines: Sequence[str], file: str) -> Dialect:
    """Find out how a file is written.

    Args:
        lines: its first lines; `SAMPLE_LINES` are enough.
        file: its name, for messages.

    Raises:
        PlanspaceError: the file has no rows, or it is unclear whether its first row has names or numbers.
    """
    plain = [line for line in _without_comments(lines) if line.strip()]
    if not plain:
        raise PlanspaceError(f"{file} has no rows of numbers.")
    delimiter = max(DELIMITERS, key=lambda delimiter: _fitness(plain, delimiter))
    first, *rest = _split(plain, delimiter)
    commas = delimiter != "," and any(DECIMAL_COMMA.fullmatch(cell) for row in (first, *rest) for cell in row)
    notices = []
    if delimiter != ",":
        notices.append(f"{file}: the columns are separated by {DELIMITERS[delimiter]}.")
    if commas:
        notices.append(f"{file}: the decimal mark is a comma.")
    names = tuple(cell.strip() for cell in first)
    if not all(_is_number(cell, commas) for cell in first):
        if not rest:
            raise PlanspaceError(f"{file} has a header, but no rows of numbers.")
        return Dialect(delimiter, names, True, commas, tuple(notices))
    if len(names) > 1 and names == tuple(map(str, range(len(names)))):
        raise PlanspaceError(
            f"{file}: its first row is {quoted(' '.join(names))}, which may number the columns or be a "
            "state; write names into the first line."
        )
    found = _commented_header(lines, delimiter, len(names))
    if found:
        notices.append(f"{file}: the names of the columns are in a comment.")
    else:
        found = tuple(f"column{i}" for i in range(len(names)))
        notices.append(f"{file} has no header: its columns are named {found[0]} to {found[-1]}.")
    return Dialect(delimiter, found, False, commas, tuple(notices))


def read_number(cell: str, decimal_comma: bool) -> float:
    """Parse a finite number.

    Args:
        cell: its text.
        decimal_comma: whether the decimal mark is a comma.

    Raises:
        ValueError: the text is not a finite number, or has the other decimal mark.
    """
    if not decimal_comma:
        return finite_number(cell)
    if "." in cell:  # either mark could separate thousands
        raise ValueError(cell)
    return finite_number(cell.replace(",", "."))


def explain_cell(cell: str, dialect: Dialect) -> str:
    """What is wrong with a cell that `read_number` refuses, as the end of a sentence.

    Args:
        cell: its text.
        dialect: how the file is written.
    """
    if dialect.decimal_comma and "." in cell:
        return f"has a decimal point in {quoted(cell)}, but other numbers of the file have decimal commas"
    if not dialect.decimal_comma and dialect.delimiter != "," and DECIMAL_COMMA.fullmatch(cell):
        return f"has a decimal comma in {quoted(cell)}, but the first rows of the file have none"
    return f"must be a finite number, got {quoted(cell)}"


def _without_comments(lines: Iterable[str]) -> Iterator[str]:
    """The lines; those before the first row that are comments are left empty, so that they still count."""
    begun = False
    for line in lines:
        is_comment = not begun and (line.lstrip().startswith(COMMENT) or not line.strip())
        begun = not is_comment
        yield "\n" if is_comment else line


def _split(lines: Iterable[str], delimiter: str, strict: bool = False) -> "csv._reader":
    if delimiter == " ":
        lines = (" ".join(line.split()) + "\n" for line in lines)
    return csv.reader(lines, delimiter=delimiter, strict=strict)


def _fitness(lines: Sequence[str], delimiter: str) -> tuple[bool, float]:
    """How well a delimiter fits: whether all rows have the same cells, and which fraction are numbers."""
    try:
        rows = list(_split(lines, delimiter))
    except csv.Error:
        return False, 0.0
    sizes = {len(row) for row in rows}
    cells = [cell for row in rows[1:] or rows for cell in row if cell.strip()]
    numbers = sum(_is_number(cell, delimiter != "," and "," in cell) for cell in cells)
    return len(sizes) == 1 and min(sizes) > 1, numbers / max(len(cells), 1) * (max(sizes, default=0) > 1)


def _is_number(cell: str, decimal_comma: bool) -> bool:
    try:
        read_number(cell, decimal_comma)
    except ValueError:
        return False
    return True


def _commented_header(lines: Sequence[str], delimiter: str, size: int) -> tuple[str, ...]:
    """The names in the last comment before the rows; empty if it has no name for each column."""
    comments = []
    for line in lines:
        if line.strip() and not line.lstrip().startswith(COMMENT):
            break
        comments.append(line.strip().lstrip(COMMENT).strip())
    for split_at in (delimiter, ",", " "):
        for names in _split([line for line in comments if line][-1:], split_at):
            if len(names) == size:
                return tuple(name.strip() for name in names)
    return ()
