"""Demonstrations from tables of named columns: the times, states and controls of each demonstration.

This is done once for all formats whose files are tables, see `planspace.demos.formats.format`.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.episode import Episode, Origin
from planspace.demos.formats.columns import NO_CONTROLS, Columns, choose_columns
from planspace.demos.formats.format import Table, Tables
from planspace.demos.guess import EPOCHS, SECONDS
from planspace.demos.recording import Imported, ImportOptions, recorded
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError, quoted


def import_tables(found: Tables, info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read the demonstrations in tables.

    Args:
        found: the tables.
        info: the states of the planning problem; None if there is no problem.
        options: which columns contain what.

    Raises:
        UsageError: an option does not fit the tables.
        PlanspaceError: a column is missing or the tables differ. Rows are read, and their errors are raised,
            while the caller iterates over the episodes.
    """
    chosen = [choose_columns(table.columns, info, options, table.file) for table in found.tables]
    first = chosen[0].info
    for table, columns in zip(found.tables, chosen, strict=True):
        if columns.info != first:
            raise PlanspaceError(
                f"{table.file} has the states ({', '.join(columns.info.names)}) and "
                f"{columns.info.num_controls} controls, but {found.tables[0].file} has "
                f"({', '.join(first.names)}) and {first.num_controls}; all files of a dataset must have the "
                "same."
            )
        if columns.time is None and options.dt is None and found.step is None:
            names = ", ".join(column.name for column in table.columns)
            raise PlanspaceError(
                f"{table.file} has no column with the name of a time; its columns are {names}. Give --time "
                "NAME, or --dt SECONDS."
            )
    has_controls = all(columns.controls for columns in chosen)
    notices = found.notices if has_controls else (*found.notices, NO_CONTROLS)
    step = options.dt or found.step
    demonstrations = (
        (table, columns, part)
        for table, columns in zip(found.tables, chosen, strict=True)
        for part in _demonstrations(table, columns)
    )
    splits: dict[str, list[int]] = {}

    def episodes() -> Iterator[Episode]:
        for index, (table, columns, part) in enumerate(demonstrations):
            if part.split:
                splits.setdefault(part.split, []).append(index)
            yield _episode(table, columns, part, step, index)

    by_column = any(columns.split is not None for columns in chosen)
    named = splits if by_column else found.splits
    return Imported(
        first, episodes(), notices, units=chosen[0].state_units, uses=chosen[0].uses, splits=named
    )


class _Part(NamedTuple):
    """The rows of a demonstration, or some of them."""

    lines: Int[np.ndarray, " row"]
    values: Float[np.ndarray, "row column"]
    """States, controls and, if there is one, the time."""
    split: str = ""
    """Name of its split; empty if the table does not say it."""


def _demonstrations(table: Table, columns: Columns) -> Iterator[_Part]:
    """The rows of each demonstration, read lazily unless rows of different demonstrations are mixed."""
    runs = _runs(table, columns)
    if columns.episode is None or columns.restarts or _is_sorted(table, columns.episode):
        for _, group in itertools.groupby(runs, lambda run: run[0]):
            yield _join([part for _, part in group])
    else:
        groups: dict[str | int, list[_Part]] = {}
        for label, part in runs:
            groups.setdefault(label, []).append(part)
        yield from map(_join, groups.values())


def _is_sorted(table: Table, column: int) -> bool:
    """Whether the rows of each demonstration follow each other."""
    seen: set[str] = set()
    last = None
    for rows in table.rows():
        for label, _ in itertools.groupby(rows.labels(column)):
            if label != last and label in seen:
                return False
            seen.add(label)
            last = label
    return True


def _runs(table: Table, columns: Columns) -> Iterator[tuple[str | int, _Part]]:
    """Consecutive rows of the same demonstration, with its name; several runs may follow each other."""
    wanted = [*columns.states, *columns.controls, *([] if columns.time is None else [columns.time])]
    count, last = 0, -np.inf
    for rows in table.rows():
        part = _Part(rows.lines, rows.numbers(wanted))
        labels: Sequence[str | int]
        if columns.episode is None:
            labels = [0] * len(part.lines)
        elif columns.restarts:
            clock = rows.numbers([columns.episode])[:, 0]
            numbers = count + np.cumsum(np.diff(clock, prepend=last) < 0)
            count, last, labels = int(numbers[-1]), float(clock[-1]), numbers.tolist()
        else:
            labels = rows.labels(columns.episode)
        splits = None if columns.split is None else rows.labels(columns.split)
        start = 0
        for label, group in itertools.groupby(labels):
            stop = start + sum(1 for _ in group)
            split = splits[start] if splits else ""
            yield label, _Part(part.lines[start:stop], part.values[start:stop], split)
            start = stop


def _join(parts: Sequence[_Part]) -> _Part:
    if len(parts) == 1:
        return parts[0]
    lines, values, splits = zip(*parts, strict=True)
    return _Part(np.concatenate(lines), np.concatenate(values), splits[0])


def _episode(table: Table, columns: Columns, part: _Part, step: float | None, index: int) -> Episode:
    origin = Origin.of_rows(table.file, table.word, part.lines)
    num, num_controls = len(columns.states), len(columns.controls)
    states, rest = part.values[:, :num], part.values[:, num:]
    controls, clock = rest[:-1, :num_controls], rest[:, num_controls:]  # the last control is not used
    _check_cells(table, columns.states, states, origin)
    _check_cells(table, columns.controls, controls, origin)
    if columns.time is None:
        assert step is not None
        times = np.arange(len(states)) * step
    else:
        _check_cells(table, (columns.time,), clock, origin)
        times = _seconds(clock[:, 0], columns.time_unit, table)
    if not columns.controls:
        controls = np.zeros((len(states) - 1, columns.info.num_controls))
    return replace(recorded(states, controls, times, index), origin=origin)


def _check_cells(
    table: Table, columns: Sequence[int], values: Float[np.ndarray, "row column"], origin: Origin
) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0].tolist()
        value, name = values[row, column], table.columns[columns[column]].name
        wrong = "is empty" if np.isnan(value) else f"must be a finite number, got {value}"
        raise PlanspaceError(
            f"{origin.place(row)}: column {quoted(name)} {wrong}. Correct it, or leave the column out with "
            f"--drop {name}."
        )


def _seconds(clock: Float[np.ndarray, " row"], unit: str, table: Table) -> Float[np.ndarray, " row"]:
    """Times in seconds. A clock without a unit that counts since 1970 tells its unit by its size."""
    if not unit:
        unit = next((name for least, name in reversed(EPOCHS) if clock[0] >= least), "s")
    if unit not in SECONDS:
        raise UsageError(
            f"{table.file}: {quoted(unit)} is not a unit of time; give --unit NAME=UNIT with one of "
            f"{', '.join(SECONDS)}."
        )
    return clock if SECONDS[unit] == 1 else (clock - clock[0]) * SECONDS[unit]
