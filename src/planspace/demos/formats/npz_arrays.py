"""NPZ archives with arrays of any names, one row per state: one demonstration, or several one after another.

Every number of a row is a column: `q` if the array has one number per row, otherwise `q[0]`, `q[1]`, ... The
demonstrations of an archive are found by one of

    offsets [E + 1]                     demonstration i is rows offsets[i] : offsets[i + 1]
    episode_ends [E]                    its last row is the one before episode_ends[i]
    terminals, timeouts, dones [N]      a demonstration ends with a row in which one of them is true
    arrays [E, T, n]                    the first axis

An archive with none of these is one demonstration. Controls may have one row less than states.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.formats.format import Column, Kind, NumberRows, Table, Tables
from planspace.demos.formats.npz_file import Column as ArrayColumn
from planspace.demos.formats.npz_file import Header, open_columns, read_headers
from planspace.errors import PlanspaceError, quoted

OFFSETS, ENDS = "offsets", "episode_ends"
FLAGS = ("terminals", "timeouts", "dones", "terminations", "truncations")
TIMES = ("time", "times", "t", "timestamp", "timestamps")
CONTROLS = ("controls", "control", "actions", "action", "ctrl", "u")
POSITIONS, VELOCITIES, ACTIVATIONS = "qpos", "qvel", "act"
TRANSITIONS = frozenset({"observation", "action", "reward", "discount"})
"""Arrays of ExORL and of other code for dm_control. The action of a row is the one that led to its state."""
PHYSICS = "physics"
"""The state of dm_control's simulator; a model is needed to tell its numbers apart."""
EPISODE = "demonstration"
"""Column with the number of the demonstration, which is added if an archive has several."""
NEEDED = (*TIMES, *CONTROLS, POSITIONS, VELOCITIES, ACTIVATIONS, PHYSICS, "state", "states")
"""Arrays that cannot be left out because they have another number of rows, or no numbers."""
MAX_LISTED = 8
"""Number of arrays that a message lists."""


@dataclass(frozen=True)
class ArrayFile:
    """An archive of arrays that have a row for each state."""

    path: Path
    sizes: Mapping[str, int]
    """How many numbers per row each array has, by name."""
    lengths: Int[np.ndarray, " demo"]
    """Number of states of each demonstration."""
    batched: bool
    """Whether the first axis of arrays is the demonstration."""
    short: frozenset[str]
    """Arrays that have one row less per demonstration than there are states."""
    late: frozenset[str]
    """Arrays whose rows belong to the state before."""
    notices: tuple[str, ...]
    """What was assumed and left out, one line each."""

    def demonstrations(self, keys: Sequence[str]) -> Iterator[dict[str, Float[np.ndarray, "_row _number"]]]:
        """Read some arrays, one demonstration at a time; missing last rows are NaN.

        Raises:
            PlanspaceError: the archive is damaged, or a demonstration does not fit in memory.
        """
        with open_columns(self.path, keys) as opened:
            for length in self.lengths.tolist():
                yield {key: self._take(key, column, length) for key, column in zip(keys, opened, strict=True)}
            for column in opened:
                column.end()

    def _take(self, key: str, column: ArrayColumn, length: int) -> Float[np.ndarray, "_row _number"]:
        found = column.take(1)[0] if self.batched else column.take(length - (key in self.short))
        rows = np.full((length, self.sizes[key]), np.nan)
        part = found.reshape(len(found), -1)[int(key in self.late) :]
        rows[: len(part)] = part
        return rows


def open_arrays(path: Path) -> ArrayFile:
    """Find out which arrays of an archive have a row for each state, and where demonstrations begin.

    Args:
        path: the archive, given by the user.

    Raises:
        PlanspaceError: the archive is damaged, no array has rows of numbers, or the arrays contradict each
            other; the message names the array.
    """
    headers = read_headers(path)
    numbers = {
        key: header.shape
        for key, header in headers.items()
        if header.is_number and header.shape and key not in (OFFSETS, ENDS)
    }
    if not numbers:
        raise PlanspaceError(f"{path} has no array with rows of numbers; it has {_listed(headers)}.")
    axes = 2 if _is_batched(headers) else 1
    lengths = _lengths(path, headers, numbers) if axes == 1 else _batch_lengths(numbers)
    count, total = len(lengths), int(lengths.sum())
    whole, less = (
        ((total,), (total - count,)) if axes == 1 else ((count, lengths[0]), (count, lengths[0] - 1))
    )
    sizes = {
        key: int(np.prod(shape[axes:], dtype=int))
        for key, shape in numbers.items()
        if len(shape) <= axes + 1 and (shape[:axes] == whole or (key in CONTROLS and shape[:axes] == less))
    }
    for key in NEEDED:
        if key in headers and key not in sizes:
            raise PlanspaceError(f"{path}: {_misfit(key, headers[key], whole, less, axes)}.")
    short = frozenset(key for key in sizes if numbers[key][:axes] != whole)
    late = frozenset({"action"} if set(sizes) >= TRANSITIONS and len(lengths) == 1 else ()) - short
    notices = []
    if late:
        notices.append(f"{path.name}: the action of a row is the one that led to its state, as in ExORL.")
    known = {*sizes, OFFSETS, ENDS}
    if left := {key: header for key, header in headers.items() if key not in known}:
        notices.append(f"{path.name}, left out: {_listed(left)}.")
    return ArrayFile(path, sizes, lengths, axes == 2, short, late, tuple(notices))


def read_arrays(files: Sequence[ArrayFile]) -> Tables:
    """Read archives as tables.

    Args:
        files: at least one archive.
    """
    notices = dict.fromkeys(notice for file in files for notice in file.notices)
    if any(PHYSICS in file.sizes for file in files):
        notices[f"to import the state of the simulator, {PHYSICS!r}, give --model FILE.xml or --problem."] = (
            None
        )
    return Tables([_table(file) for file in files], notices=tuple(notices))


def _table(file: ArrayFile) -> Table:
    columns = [
        Column(name, kind=_kind(key))
        for key, size in file.sizes.items()
        for name in ([key] if size == 1 else [f"{key}[{i}]" for i in range(size)])
    ]
    several = len(file.lengths) > 1
    if several:
        columns.append(Column(EPISODE, kind="episode"))

    def rows() -> Iterator[NumberRows]:
        first = 0
        for i, arrays in enumerate(file.demonstrations(list(file.sizes))):
            num = int(file.lengths[i])
            numbers = np.concatenate([*arrays.values(), *([np.full((num, 1), i)] if several else [])], axis=1)
            yield NumberRows(first + np.arange(num), numbers)
            first += num

    return Table(str(file.path), tuple(columns), rows)


def _kind(key: str) -> Kind | None:
    if key in TIMES:
        return "time"
    return "control" if key in CONTROLS else "unused" if key in (*FLAGS, PHYSICS) else None


# --- demonstrations ---------------------------------------------------------------------------------


def _is_batched(headers: Mapping[str, Header]) -> bool:
    """Whether the first axis of arrays is the demonstration: then all of them share their first two axes."""
    if any(key in headers for key in (OFFSETS, ENDS)):
        return False
    shapes = [header.shape for header in headers.values() if header.kind == "f" and len(header.shape) > 1]
    if not any(len(shape) == 3 for shape in shapes):
        return False
    count, length = max(shape[:2] for shape in shapes)
    return {shape[:2] for shape in shapes} <= {(count, length), (count, length - 1)}


def _batch_lengths(numbers: Mapping[str, tuple[int, ...]]) -> Int[np.ndarray, " demo"]:
    count, length = max(shape[:2] for shape in numbers.values() if len(shape) == 3)
    return np.full(count, length)


def _lengths(
    path: Path, headers: Mapping[str, Header], numbers: Mapping[str, tuple[int, ...]]
) -> Int[np.ndarray, " demo"]:
    """Number of states of each demonstration in arrays that lie one after another."""
    key = next((key for key in (OFFSETS, ENDS) if key in headers), None)
    if key is None:
        counts = Counter(shape[0] for name, shape in numbers.items() if name not in CONTROLS)
        num = max(counts, key=lambda size: (counts[size], size), default=0)
        bounds = _flagged(path, numbers, num)
    else:
        with open_columns(path, [key], integers=[key]) as (column,):
            bounds = column.take(column.shape[0]).astype(int) if len(column.shape) == 1 else np.zeros(0, int)
        bounds = np.concatenate([[0], bounds]) if key == ENDS else bounds
        if len(bounds) < 2 or bounds[0] != 0 or (np.diff(bounds) < 0).any():
            raise PlanspaceError(f"{path}: {key!r} must rise to the number of rows, got {quoted(bounds)}.")
        if not any(shape[0] == bounds[-1] for shape in numbers.values()):
            raise PlanspaceError(
                f"{path}: {key!r} ends at {bounds[-1]}, but no array has this many rows: {_listed(headers)}."
            )
    lengths = np.diff(bounds)
    if len(lengths) == 0 or lengths.min() < 1:
        raise PlanspaceError(f"{path}: demonstration {np.argmin(lengths)} has no states.")
    return lengths


def _flagged(path: Path, numbers: Mapping[str, tuple[int, ...]], num: int) -> Int[np.ndarray, " bound"]:
    """Bounds of the demonstrations that end where an array such as `terminals` is true."""
    flags = [key for key in FLAGS if numbers.get(key) in ((num,), (num, 1))]
    if not flags:
        return np.array([0, num])
    with open_columns(path, flags) as columns:
        ends = np.any([column.take(num).reshape(num) != 0 for column in columns], axis=0)
    inner = np.flatnonzero(ends[:-1]) + 1
    return np.concatenate([[0], inner, [num]])


def _misfit(key: str, header: Header, whole: tuple[int, ...], less: tuple[int, ...], axes: int) -> str:
    """Why an array has no row for each state."""
    if not header.is_number:
        return f"{key!r} does not hold numbers; save it with `astype(float)`"
    if len(header.shape) not in (axes, axes + 1):
        return (
            f"{key!r} has the shape {list(header.shape)}; expected {axes + 1} axes, the last one for numbers"
        )
    rows, wanted, shorter = (" x ".join(map(str, shape)) for shape in (header.shape[:axes], whole, less))
    also = f", or {shorter} without the last of each demonstration" if key in CONTROLS else ""
    return f"{key!r} has {rows} rows; expected {wanted}{also}"


def _listed(headers: Mapping[str, Header]) -> str:
    names = [
        f"{key} {list(header.shape)}" + ("" if header.is_number else " (not numbers)")
        for key, header in headers.items()
    ]
    return ", ".join([*names[:MAX_LISTED], *(["..."] if len(names) > MAX_LISTED else [])]) or "nothing"
