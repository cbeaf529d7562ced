"""NPZ archives of plain arrays, read one episode at a time.

The arrays are `states` [N, n], `controls` [N, m], `time` [N] in seconds, and `offsets`: episode i is rows
offsets[i] : offsets[i + 1]. A control is held from the state in its row on; the last one of an episode is not
used.
"""

import io
import itertools
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.formats.format import Format, has_suffix
from planspace.demos.recording import (
    Imported,
    ImportOptions,
    anonymous_info,
    check_options,
    check_rising,
    recorded,
    source_name,
)
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from planspace.storage.checks import MAX_BYTES, check_file, explain_read
from planspace.storage.files import write_bytes

KEYS = ("states", "controls", "time", "offsets")
COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""The compressions that NumPy uses. Others can expand a few bytes without limit."""
MAX_EXPANSION = 1032
"""Most bytes that one byte of deflate expands to: 258 bytes for two bits."""
MAX_EPISODE_BYTES = MAX_BYTES // 8
"""Largest array of one demonstration; several copies of it exist at the same time."""
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read an archive.

    Args:
        sources: one archive.
        info: the states of the planning problem. If None, the states are named `state0`, `state1`, ... and
            none of them is an angle.
        options: none of them can be used.

    Raises:
        UsageError: there are several archives, or an option was given.
        PlanspaceError: an array is missing, shapes do not fit, times do not increase, or the archive contains
            Python objects; the message names the episode and row.
    """
    name = source_name(sources)
    check_options(options, name)
    if len(sources) > 1:
        raise UsageError(f"{name} contains {len(sources)} NPZ archives; import one at a time.")
    file = Path(sources[0])
    with _columns(file, KEYS) as (states, controls, times, offsets):
        if (len(states.shape), len(controls.shape), len(times.shape)) != (2, 2, 1) or not (
            states.shape[0] == controls.shape[0] == times.shape[0]
        ):
            raise PlanspaceError(
                f"{file}: states {states.shape}, controls {controls.shape} and time {times.shape} must have "
                "two, two and one axes and the same number of rows."
            )
        bounds = offsets.take(offsets.shape[0]) if len(offsets.shape) == 1 else np.zeros(0)
    num = states.shape[0]
    if len(bounds) < 2 or bounds[0] != 0 or bounds[-1] != num:
        raise PlanspaceError(f"{file}: offsets must run from 0 to the number of rows, {num}.")
    lengths = np.diff(bounds.astype(int))
    if (lengths < 2).any():
        raise PlanspaceError(f"{file}: episode {np.argmin(lengths)} has fewer than two states.")
    info = info or anonymous_info(states.shape[1], controls.shape[1])
    return Imported(info, _episodes(file, lengths))


def write_npz(demos: Demos, target: str) -> Path:
    """Write demonstrations to an NPZ archive; the last control of each is zero."""
    controls = np.zeros((len(demos.states), demos.info.num_controls))
    has_control = np.ones(len(demos.states), dtype=bool)
    has_control[demos.offsets[1:] - 1] = False
    controls[has_control] = demos.controls
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, states=demos.states, controls=controls, time=demos.times, offsets=demos.offsets
    )
    write_bytes(Path(target), buffer.getvalue())
    return Path(target)


def _episodes(file: Path, lengths: np.ndarray) -> Iterator[Episode]:
    with _columns(file, KEYS[:3]) as columns:
        row = 0
        for i, length in enumerate(lengths.tolist()):
            states, controls, times = (column.take(length).astype(float) for column in columns)
            check_rising(times, lambda k, i=i, row=row: f"{file}, episode {i}, row {row + k}")
            yield recorded(states, controls[:-1], times, i)
            row += length
        for column in columns:
            column.end()


class _Column:
    """An array in an archive, read from start to end, a few rows at a time."""

    def __init__(self, source: Any, key: str, file: Path):
        self._source = source  # a binary file
        version = np.lib.format.read_magic(self._source)
        if version not in _HEADERS:
            raise ValueError(f"{key} has the unknown version {version} of NumPy's format")
        self.shape, by_column, self._dtype = _HEADERS[version](self._source)
        if self._dtype.hasobject:
            raise ValueError(f"{key} contains Python objects")
        if self._dtype.kind not in ("iu" if key == "offsets" else "iuf"):
            raise PlanspaceError(f"{file}: the array {key!r} must contain numbers, got type {self._dtype}.")
        if not all(size >= 0 for size in self.shape):
            raise ValueError(f"{key} has the shape {self.shape}")
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
def _columns(file: Path, keys: Sequence[str]) -> Iterator[list[_Column]]:
    check_file(file, may_be_link=True)
    with _explained(file), ExitStack() as opened:
        archive = opened.enter_context(zipfile.ZipFile(file))
        missing = [key for key in keys if f"{key}.npy" not in archive.namelist()]
        if missing:
            raise PlanspaceError(f"{file} has no array {missing[0]!r}; it needs {', '.join(KEYS)}.")
        for part in (archive.getinfo(f"{key}.npy") for key in keys):
            if part.compress_type not in COMPRESSIONS:
                raise ValueError(f"{part.filename} has a compression that NumPy does not use")
            if part.file_size > MAX_EXPANSION * file.stat().st_size:
                raise ValueError(f"{part.filename} claims more bytes than the archive can contain")
        sources = [opened.enter_context(archive.open(f"{key}.npy")) for key in keys]
        yield [_Column(source, key, file) for source, key in zip(sources, keys, strict=True)]


@contextmanager
def _explained(file: Path) -> Iterator[None]:
    try:
        with explain_read(file):
            yield
    except PlanspaceError:
        raise
    except Exception as error:  # zipfile, its decompressors and NumPy raise many types
        text = " ".join(str(error).split()) or type(error).__name__
        raise PlanspaceError(f"{file} is not a readable NPZ archive of plain arrays ({text}).") from error


NPZ = Format("FILE.npz", has_suffix(".npz"), read_npz, write_npz)
