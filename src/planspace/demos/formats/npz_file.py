"""Checked reading of NPZ archives: plain arrays, a few rows at a time.

An archive can contain Python objects, whose reading runs code, and a few bytes of it can claim or expand to
any size. Such archives are rejected.
"""

import itertools
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from planspace.errors import PlanspaceError
from planspace.storage.checks import MAX_BYTES, check_file, explain_read

COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""The compressions that NumPy uses. Others can expand a few bytes without limit."""
MAX_EXPANSION = 1032
"""Most bytes that one byte of deflate expands to: 258 bytes for two bits."""
MAX_EPISODE_BYTES = MAX_BYTES // 8
"""Largest array of one demonstration; several copies of it exist at the same time."""
MAX_ARRAYS = 10_000
"""An archive with more arrays is rejected; no recorder writes as many."""
SUFFIX = ".npy"
INTEGERS, NUMBERS = "iu", "iufb"
"""Kinds of NumPy types."""
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


class Header(NamedTuple):
    """What an archive says about one of its arrays."""

    shape: tuple[int, ...]
    kind: str
    """Kind of NumPy type: `f`, `i`, `u` and `b` are numbers; `O` are Python objects."""

    @property
    def is_number(self) -> bool:
        """Whether it consists of numbers."""
        return self.kind in NUMBERS


def read_headers(file: Path) -> dict[str, Header]:
    """The shape and the kind of every array of an archive; the arrays themselves are not read.

    Raises:
        PlanspaceError: the archive is damaged.
    """
    headers = {}
    with _opened(file) as archive:
        names = [name for name in archive.namelist() if name.endswith(SUFFIX)]
        if len(names) > MAX_ARRAYS:
            raise ValueError(f"it has {len(names)} arrays")
        for name in names:
            with archive.open(name) as source:
                shape, _, dtype = _read_header(source, name)
            headers[name.removesuffix(SUFFIX)] = Header(shape, dtype.kind)
    return headers


class Column:
    """An array in an archive, read from start to end, a few rows at a time."""

    def __init__(self, source: Any, key: str, file: Path, kinds: str):
        self._source = source  # a binary file
        self.shape, by_column, self._dtype = _read_header(source, key)
        if self._dtype.hasobject:
            raise ValueError(f"{key} contains Python objects")
        if self._dtype.kind not in kinds:
            raise PlanspaceError(f"{file}: the array {key!r} must contain numbers, got type {self._dtype}.")
        self._whole: Iterator[np.ndarray] | None = None
        if by_column and len(self.shape) > 1:  # rows are not contiguous
            flat = self._read(int(np.prod(self.shape, dtype=object)), MAX_BYTES)
            self._whole = iter(flat.reshape(self.shape, order="F"))

    def take(self, num: int) -> np.ndarray:
        """Read the next rows."""
        if self._whole is not None:
            return np.stack(list(itertools.islice(self._whole, num)))
        rest = self.shape[1:]
        return self._read(num * int(np.prod(rest, dtype=object)), MAX_EPISODE_BYTES).reshape(num, *rest)

    def end(self) -> None:
        """Check that the array ends here; the zip file verifies its checksum at this point."""
        if self._source.read(1):
            raise ValueError("an array is longer than its header says")

    def _read(self, num: int, most: int) -> np.ndarray:
        if 8 * num > most:  # they are stored as float64
            raise ValueError(f"an array of {num} numbers does not fit in memory")
        size = num * self._dtype.itemsize
        data = self._source.read(size)
        if len(data) < size:
            raise EOFError("an array is shorter than its header says")
        return np.frombuffer(data, dtype=self._dtype)


@contextmanager
def open_columns(file: Path, keys: Sequence[str], integers: Sequence[str] = ()) -> Iterator[list[Column]]:
    """Open arrays of an archive.

    Args:
        file: the archive, given by the user.
        keys: names of the arrays.
        integers: the arrays among them that must contain integers; the others contain numbers.

    Yields:
        The arrays in this order.

    Raises:
        PlanspaceError: an array is missing or does not contain numbers, or the archive is damaged. Errors
            inside the block are also turned into this error.
    """
    with _opened(file) as archive, ExitStack() as opened:
        missing = [key for key in keys if f"{key}{SUFFIX}" not in archive.namelist()]
        if missing:
            raise PlanspaceError(f"{file} has no array {missing[0]!r}; it needs {', '.join(keys)}.")
        for part in (archive.getinfo(f"{key}{SUFFIX}") for key in keys):
            if part.compress_type not in COMPRESSIONS:
                raise ValueError(f"{part.filename} has a compression that NumPy does not use")
            if part.file_size > MAX_EXPANSION * file.stat().st_size:
                raise ValueError(f"{part.filename} claims more bytes than the archive can contain")
        sources = [opened.enter_context(archive.open(f"{key}{SUFFIX}")) for key in keys]
        yield [
            Column(source, key, file, INTEGERS if key in integers else NUMBERS)
            for source, key in zip(sources, keys, strict=True)
        ]


@contextmanager
def _opened(file: Path) -> Iterator[zipfile.ZipFile]:
    check_file(file, may_be_link=True)
    try:
        with explain_read(file), zipfile.ZipFile(file) as archive:
            yield archive
    except PlanspaceError:
        raise
    except Exception as error:  # zipfile, its decompressors and NumPy raise many types
        text = " ".join(str(error).split()) or type(error).__name__
        raise PlanspaceError(f"{file} is not a readable NPZ archive of plain arrays ({text}).") from error


def _read_header(source: Any, key: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(source)
    if version not in _HEADERS:
        raise ValueError(f"{key} has the unknown version {version} of NumPy's format")
    shape, by_column, dtype = _HEADERS[version](source)
    if not all(size >= 0 for size in shape):
        raise ValueError(f"{key} has the shape {shape}")
    return shape, by_column, dtype
