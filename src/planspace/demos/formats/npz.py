"""NPZ archives of plain arrays.

planspace writes `states` [N, n], `controls` [N, m], `time` [N] in seconds, and `offsets`: episode i is rows
offsets[i] : offsets[i + 1]. A control is held from the state in its row on; the last one of an episode is not
used. Archives of other programs are recognised by the names of their arrays.
"""

import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.formats.format import Format, Tables, has_suffix
from planspace.demos.formats.npz_arrays import open_arrays, read_arrays
from planspace.demos.formats.npz_file import open_columns, read_headers
from planspace.demos.formats.npz_mujoco import has_mujoco_states, read_mujoco_states
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
from planspace.errors import PlanspaceError
from planspace.storage.files import write_bytes

KEYS = ("states", "controls", "time", "offsets")


def read_npz(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported | Tables:
    """Read archives.

    Args:
        sources: at least one archive, in the order of the demonstrations.
        info: the states of the planning problem. If None, the states of an archive by planspace are named
            `state0`, `state1`, ... and none of them is an angle.
        options: with any option that chooses arrays or times, an archive by planspace is read like those of
            other programs.

    Raises:
        UsageError: an option does not fit the layout.
        PlanspaceError: an array is missing, shapes do not fit, times do not increase, or the archive contains
            Python objects; the message names the episode and row.
    """
    name = source_name(sources)
    check_options(options, name, "state", "control", "dt", "time", "episode")
    chosen = options.states or options.controls or options.dt or options.time or options.episode
    if not chosen and all(set(KEYS) <= set(read_headers(Path(source))) for source in sources):
        return _read_exported(list(map(Path, sources)), info)
    files = [open_arrays(Path(source)) for source in sources]
    if not options.states and has_mujoco_states(files, info):
        check_options(options, name, "dt")
        return read_mujoco_states(files, info, options)
    return read_arrays(files)


def _read_exported(files: Sequence[Path], info: StateInfo | None) -> Imported:
    found = [_lengths(file) for file in files]
    info = info or anonymous_info(*found[0][1])
    return Imported(info, _episodes(files, [lengths for lengths, _ in found]))


def _lengths(file: Path) -> tuple[Int[np.ndarray, " demo"], tuple[int, int]]:
    """Number of states of each demonstration, and the sizes of a state and a control."""
    with open_columns(file, KEYS, integers=KEYS[3:]) as (states, controls, times, offsets):
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
    return lengths, (states.shape[1], controls.shape[1])


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


def _episodes(files: Sequence[Path], found: Sequence[np.ndarray]) -> Iterator[Episode]:
    index = 0
    for file, lengths in zip(files, found, strict=True):
        with open_columns(file, KEYS[:3]) as columns:
            row = 0
            for i, length in enumerate(lengths.tolist()):
                states, controls, times = (column.take(length).astype(float) for column in columns)
                check_rising(times, lambda k, i=i, row=row, file=file: f"{file}, episode {i}, row {row + k}")
                yield recorded(states, controls[:-1], times, index)
                row, index = row + length, index + 1
            for column in columns:
                column.end()


NPZ = Format("FILE.npz", has_suffix(".npz"), read_npz, write_npz)
