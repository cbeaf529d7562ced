"""Parquet files of named columns (extra `data`): one row per state.

A column contains numbers, or lists of numbers of the same length, whose numbers are the columns `q[0]`,
`q[1]`, ... Other columns are left out. A LeRobot dataset is a folder of such files; `lerobot.py` reads it
with its names and times.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planspace.demos.formats.format import Column, Format, Kind, NumberRows, Table, Tables, has_suffix
from planspace.demos.formats.npz_arrays import CONTROLS
from planspace.demos.formats.parquet_file import open_parquet, read_batches
from planspace.demos.formats.reader_subprocess import read_in_subprocess
from planspace.demos.guess import split_unit
from planspace.demos.recording import Imported, ImportOptions, check_options, source_name
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError

Sizes = dict[str, int]


def read_parquet(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Tables | Imported:
    """Read Parquet files: one demonstration per file, or one per value of a column such as `episode`.

    Args:
        sources: at least one file, in the order of the demonstrations.
        info: the states of the planning problem; None if there is no problem.
        options: see `planspace.demos.tables`.

    Raises:
        UsageError: an option cannot be used.
        PlanspaceError: pyarrow is not installed, or a file cannot be read or has no numbers.
    """
    check_options(options, source_name(sources), "state", "control", "dt", "time", "episode")
    if options.untrusted:
        return read_in_subprocess("parquet", sources, info, options)
    found = [_sizes(Path(source)) for source in sources]
    tables = [_table(Path(source), sizes) for source, (sizes, _) in zip(sources, found, strict=True)]
    left = sorted({name for _, names in found for name in names})
    notices = (f"left out, because they are not numbers: {', '.join(left)}.",) if left else ()
    return Tables(tables, notices=notices)


def _sizes(file: Path) -> tuple[Sizes, list[str]]:
    """How many numbers per row each column has, and the columns that are not numbers."""
    with open_parquet(file, may_be_link=True) as opened:
        kinds = {field.name: field.type for field in opened.schema_arrow}
        columns = [name for name, kind in kinds.items() if _is_numbers(kind)]
        if not columns:
            raise PlanspaceError(f"{file} has no column of numbers; it has {', '.join(kinds) or 'nothing'}.")
        first = next(read_batches(opened, columns, file), None)
    if first is None:
        raise PlanspaceError(f"{file} has no rows.")
    return {name: first[name].shape[1] for name in columns}, [name for name in kinds if name not in columns]


def _is_numbers(kind: Any) -> bool:
    from pyarrow import types

    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        kind = kind.value_type
    return types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)


def _table(file: Path, sizes: Sizes) -> Table:
    columns = []
    for name, size in sizes.items():
        kind: Kind | None = "control" if name in CONTROLS else None
        names = [name] if size == 1 else [f"{name}[{i}]" for i in range(size)]
        columns += [Column(split_unit(each).name, split_unit(each).unit, kind) for each in names]

    def rows() -> Iterator[NumberRows]:
        first = 0
        with open_parquet(file, may_be_link=True) as opened:
            for batch in read_batches(opened, list(sizes), file):
                numbers = np.concatenate([batch[name].astype(float) for name in sizes], axis=1)
                if numbers.shape[1] != len(columns):
                    raise PlanspaceError(f"{file}: a list has another length after row {first}.")
                yield NumberRows(first + np.arange(len(numbers)), numbers)
                first += len(numbers)

    return Table(str(file), tuple(columns), rows)


PARQUET = Format("FILE.parquet", has_suffix(".parquet"), read_parquet)
