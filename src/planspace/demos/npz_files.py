"""Demonstrations from and to NPZ archives of plain arrays; one is read an episode at a time.

states [N, n], controls [N, m] (held from that state on; the last row of an episode means nothing), time [N]
in seconds, and offsets: episode i is rows offsets[i] : offsets[i + 1].
"""

import io
import itertools
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos, Episode, StateInfo
from planspace.demos.recording import Imported, anonymous_info, check_rising, recorded
from planspace.errors import PlanspaceError
from planspace.storage.checks import MAX_BYTES, check_file, explain_read
from planspace.storage.files import write_bytes

KEYS = ("states", "controls", "time", "offsets")
COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""NumPy's; others can make anything of a few bytes."""
MOST_DEFLATED = 1032
"""Bytes that one of deflate's becomes at most: 258 for two bits."""
MAX_EPISODE_BYTES = MAX_BYTES // 8
"""Of one array of a demonstration, of which several copies are made on its way."""
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(file: Path, info: StateInfo | None) -> Imported:
    """Reads an archive.

    Args:
        file: the archive.
        info: what the states are; without it they get names `state0`, `state1` ... and no angle is taken to
            be circular.

    Raises:
        PlanspaceError: a key is missing, shapes do not fit, pickled objects, or a number that is not finite
            (the episode and row are named).
    """
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


def export_npz(demos: Demos, file: Path) -> None:
    """Writes demonstrations as an NPZ archive that `read_npz` reads; the last control of each is zero."""
    controls = np.zeros((len(demos.states), demos.info.num_controls))
    has_control = np.ones(len(demos.states), dtype=bool)
    has_control[demos.offsets[1:] - 1] = False
    controls[has_control] = demos.controls
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, states=demos.states, controls=controls, time=demos.times, offsets=demos.offsets
    )
    write_bytes(file, buffer.getvalue())


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
    """An array in an archive, taken a few rows at a time from the first one on."""

    def __init__(self, source: Any, key: str, file: Path):
        self._source = source  # open for reading bytes
        version = np.lib.format.read_magic(self._source)
        if version not in _HEADERS:
            raise ValueError(f"{key} is written in version {version} of NumPy's format")
        self.shape, by_column, self._dtype = _HEADERS[version](self._source)
        if self._dtype.hasobject:
            raise ValueError(f"{key} holds Python objects")
        if self._dtype.kind not in ("iu" if key == "offsets" else "iuf"):
            raise PlanspaceError(f"{file}: the array {key!r} is of type {self._dtype}; numbers are needed.")
        if not all(size >= 0 for size in self.shape):
            raise ValueError(f"{key} has the shape {self.shape}")
        self._whole: Iterator[np.ndarray] | None = None
        if by_column and len(self.shape) > 1:  # a row is then all over the file
            flat = self._read(int(np.prod(self.shape, dtype=object)), MAX_BYTES)
            self._whole = iter(flat.reshape(self.shape, order="F"))

    def take(self, num: int) -> np.ndarray:
        """The next rows."""
        if self._whole is not None:
            return np.stack(list(itertools.islice(self._whole, num)))
        rest = self.shape[1:]
        return self._read(num * int(np.prod(rest, dtype=object)), MAX_EPISODE_BYTES).reshape(num, *rest)

    def end(self) -> None:
        """Sees that there is no more; the archive's own checksum is looked at then."""
        if self._source.read(1):
            raise ValueError("an array is longer than it says")

    def _read(self, num: int, most: int) -> np.ndarray:
        if 8 * num > most:  # they are kept as float64
            raise ValueError(f"{num} numbers at once are too many for this machine's memory")
        size = num * self._dtype.itemsize
        data = self._source.read(size)
        if len(data) < size:
            raise EOFError("an array is shorter than it says")
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
                raise ValueError(f"{part.filename} is compressed otherwise than NumPy does")
            if part.file_size > MOST_DEFLATED * file.stat().st_size:
                raise ValueError(f"{part.filename} says that it has more bytes than the archive can hold")
        sources = [opened.enter_context(archive.open(f"{key}.npy")) for key in keys]
        yield [_Column(source, key, file) for source, key in zip(sources, keys, strict=True)]


@contextmanager
def _explained(file: Path) -> Iterator[None]:
    try:
        with explain_read(file):
            yield
    except PlanspaceError:
        raise
    except Exception as error:  # what zipfile, its decompressors and NumPy raise on nonsense is no short list
        text = " ".join(str(error).split()) or type(error).__name__
        raise PlanspaceError(f"{file} is not a readable NPZ archive of plain arrays ({text}).") from error
