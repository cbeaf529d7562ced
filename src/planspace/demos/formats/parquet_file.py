"""Checked reading of Parquet files (extra `data`).

A Parquet file can keep its columns in other files, and a few bytes of it can declare billions of rows. No
recorder writes such files, so they are rejected.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from planspace.errors import PlanspaceError, install_command, quoted
from planspace.storage.checks import MAX_BYTES, check_file, explain_library_read

MAX_EXPANSION = 1032
"""Most bytes of numbers that one byte of a file may expand to; the numbers of the rows of a recording differ,
so no codec compresses them better."""
MAX_GROUP_BYTES = MAX_BYTES // 8
"""Largest row group [bytes]; several copies of it exist at the same time."""
BATCH_ROWS = 1 << 16
"""Number of rows that are read at a time."""
TEXT_BYTES = 1 << 20
"""Largest text that is read from a file's header."""


def parquet_module() -> Any:
    """Import `pyarrow.parquet`.

    Raises:
        PlanspaceError: it is not installed.
    """
    try:
        from pyarrow import parquet
    except ImportError as error:
        raise PlanspaceError(f"Parquet files need the package pyarrow: {install_command('data')}.") from error
    return parquet


@contextmanager
def open_parquet(file: Path, *, may_be_link: bool = False) -> Iterator[Any]:
    """Open a Parquet file for reading, after a check that it refers to no other files.

    Args:
        file: the file.
        may_be_link: whether it may be a link out of its folder; set it for a file that the user gave.

    Yields:
        The `pyarrow.parquet.ParquetFile`. Read its columns with `read_batches`.

    Raises:
        PlanspaceError: pyarrow is not installed, or the file cannot be read, refers to other files or
            declares more rows than it can contain. Errors of Arrow inside the block are also turned into this
            error.
    """
    parquet = parquet_module()
    check_file(file, may_be_link=may_be_link)
    with explain_library_read(file, "Parquet", longest=200), open(file, "rb") as source:
        opened = parquet.ParquetFile(
            source, thrift_string_size_limit=TEXT_BYTES, memory_map=False, pre_buffer=False
        )
        _check_metadata(opened.metadata, file)
        yield opened


def read_batches(
    opened: Any, columns: Sequence[str], file: Path
) -> Iterator[dict[str, Shaped[np.ndarray, "_row _number"]]]:
    """Read columns of numbers, some rows at a time.

    Args:
        opened: the file that `open_parquet` yielded.
        columns: names of columns. Each contains numbers, or lists of numbers that all have the same length.
        file: its path, for messages.

    Yields:
        The numbers of consecutive rows by column.

    Raises:
        PlanspaceError: a column is missing, does not contain numbers or has gaps, or the rows do not fit in
            memory; the message names the column and the row.
    """
    names = opened.schema_arrow.names
    for name in columns:
        if name not in names:
            raise PlanspaceError(f"{file} has no column {name!r}; it has {_listed(names)}.")
    _check_groups(opened.metadata, set(columns), file)
    row = 0
    for batch in opened.iter_batches(BATCH_ROWS, columns=list(columns), use_threads=False):
        yield {name: _numbers(batch.column(name), f"{file}: column {name!r}", row) for name in columns}
        row += batch.num_rows


def read_column(opened: Any, name: str, file: Path) -> list[int]:
    """Read a whole column of integers; see `read_batches`.

    Raises:
        PlanspaceError: the column is missing or does not contain integers.
    """
    parts = [batch[name] for batch in read_batches(opened, [name], file)]
    if any(part.dtype.kind not in "iu" or part.shape[1] != 1 for part in parts):
        raise PlanspaceError(f"{file}: column {name!r} must contain one integer per row.")
    return [int(number) for part in parts for number in part[:, 0]]


def _check_metadata(metadata: Any, file: Path) -> None:
    most = MAX_EXPANSION * file.stat().st_size
    if not 0 <= 8 * metadata.num_rows <= most:
        raise PlanspaceError(f"{file} declares {metadata.num_rows} rows, more than its bytes can contain.")
    for group in map(metadata.row_group, range(metadata.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            if column.file_path:
                raise PlanspaceError(
                    f"{file} keeps the column {column.path_in_schema!r} in another file, "
                    f"{quoted(column.file_path)}; planspace does not read such files."
                )


def _check_groups(metadata: Any, columns: set[str], file: Path) -> None:
    """Check that the chosen columns of every row group fit in memory."""
    for i, group in enumerate(map(metadata.row_group, range(metadata.num_row_groups))):
        chunks = map(group.column, range(group.num_columns))
        size = sum(c.total_uncompressed_size for c in chunks if c.path_in_schema.split(".list")[0] in columns)
        if size > MAX_GROUP_BYTES:
            raise PlanspaceError(f"{file}: row group {i} has {size} bytes, which do not fit in memory.")


def _numbers(column: Any, where: str, row: int) -> Shaped[np.ndarray, "row number"]:
    """The numbers of a column of a record batch, one row per row."""
    from pyarrow import types

    kind, values, size = column.type, column, 1
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        _check_complete(column, where, row)
        values, kind = column.flatten(), kind.value_type
        size = len(values) // max(len(column), 1)
        if not types.is_fixed_size_list(column.type):
            lengths = column.value_lengths().to_numpy(zero_copy_only=False)
            if bad := np.flatnonzero(lengths != size).tolist():
                raise PlanspaceError(
                    f"{where} has lists of different lengths: {size} numbers in most rows, {lengths[bad[0]]} "
                    f"in row {row + bad[0]}."
                )
    if not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)):
        raise PlanspaceError(f"{where} must contain numbers or lists of numbers, got {column.type}.")
    _check_complete(values, where, row, size)
    return values.to_numpy(zero_copy_only=False).reshape(len(column), size)


def _check_complete(values: Any, where: str, row: int, size: int = 1) -> None:
    if values.null_count:
        first = int(np.flatnonzero(values.is_null().to_numpy(zero_copy_only=False))[0])
        raise PlanspaceError(f"{where} is empty in row {row + first // max(size, 1)}.")


def _listed(names: Sequence[str]) -> str:
    return ", ".join([*map(quoted, names[:12]), *(["..."] if len(names) > 12 else [])]) or "none"
