"""CSV files of results to which benchmarks add row by row, so that an interrupted benchmark goes on."""

import argparse
import csv
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

Row = dict[str, str]


def read_rows(path: Path) -> list[Row]:
    """Read the rows that were measured before; none if the file does not exist."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Write all rows, in this order."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(columns), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def make_parser(doc: str | None, folder: str = "") -> argparse.ArgumentParser:
    """Make the parser of a benchmark, with `--table`.

    Args:
        doc: the module's docstring.
        folder: what the folder is for, if the benchmark needs one.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if folder:
        parser.add_argument("folder", type=Path, nargs="?", help=folder)
    parser.add_argument("--table", action="store_true", help="print the table and do nothing else")
    return parser


def parse(
    parser: argparse.ArgumentParser, results: Path, table: Callable[[list[Row]], str]
) -> tuple[argparse.Namespace, list[Row]]:
    """Parse the options and read the rows; with `--table`, print the table and exit."""
    options, rows = parser.parse_args(), read_rows(results)
    if options.table:
        print(table(rows))
        parser.exit()
    if "folder" in options and options.folder is None:
        parser.error("give a folder for what the benchmark makes")
    return options, rows


def has_row(rows: Iterable[Row], key: Row) -> bool:
    """Whether a row has these values."""
    return any(key.items() <= row.items() for row in rows)


def add_row(path: Path, columns: Sequence[str], rows: list[Row], row: Row) -> None:
    """Add a row to the others and to the file, and print it.

    The file is read again first: the same benchmark may run on another core and add rows of its own.
    """
    rows.append(row)
    print(*(row[column] for column in columns), sep="  ", flush=True)
    write_rows(path, columns, [*read_rows(path), row])


def add_missing(
    path: Path, columns: Sequence[str], rows: list[Row], key: Row, measure: Callable[[], Row]
) -> None:
    """Measure and add a row, unless a row has the values of the key already."""
    if not has_row(rows, key):
        add_row(path, columns, rows, key | measure())
