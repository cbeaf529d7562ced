"""Printing results on a terminal: as JSON, as lines, or as columns."""

import json
from collections.abc import Mapping
from typing import Any

from planspace.errors import printable


def counted(num: int, noun: str) -> str:
    """Return a number with its noun, in the singular or the plural: `1 unit`, `2 units`."""
    return f"{num} {noun}" if num == 1 else f"{num} {noun}s"


def print_json(values: Mapping[str, Any]) -> None:
    """Print values as JSON."""
    print(json.dumps(values, indent=2))


def print_values(values: Mapping[str, Any], *, as_json: bool = False, indent: str = "") -> None:
    """Print nested values, one a line, or all of them as JSON."""
    if as_json:
        print_json(values)
        return
    for key, item in values.items():
        if isinstance(item, Mapping):
            print(printable(f"{indent}{key}"))
            print_values(item, indent=indent + "  ")
        else:
            print(printable(f"{indent}{key:<22}{_short(item)}"))


def print_columns(title: str, columns: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table with one row for each entry of the first column.

    Args:
        title: printed above the names of the rows.
        columns: name of a column to its values by row; a missing value leaves its cell empty,
            and None is shown as n/a.
    """
    print(f"{title:<20}" + "".join(f"{name:>18}" for name in columns))
    for row in next(iter(columns.values())):
        cells = [_short(column.get(row, "")) for column in columns.values()]
        print(printable(f"  {row:<18}" + "".join(f"{cell:>18}" for cell in cells)))


def _short(value: Any) -> str:
    if value is None:
        return "n/a"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
