"""Demonstrations from and to other formats."""

import io
import zipfile
from pathlib import Path

import numpy as np

from planspace.demos.dataset import DemoFolder, Demos, Episode, StateInfo
from planspace.errors import PlanspaceError
from planspace.store import file_hash, read_bytes, write_bytes

NPZ_KEYS = ("states", "controls", "time", "offsets")
IMPORT_SHARD_EPISODES = 256


def import_npz(file: Path, out: Path, info: StateInfo | None) -> DemoFolder:
    """Imports demonstrations from an NPZ archive.

    Args:
        file: an archive with `states` [N, n], `controls` [N, m] (held from that state on; the last row of
            an episode means nothing), `time` [N] in seconds, and `offsets`: episode i is rows
            offsets[i] : offsets[i + 1].
        out: the dataset folder to make.
        info: what the states are; without it they get names `state0`, `state1` ... and no angle is taken
            to be circular.

    Raises:
        PlanspaceError: a key is missing, shapes do not fit, pickled objects, or a number that is not finite
            (the episode and row are named).
    """
    arrays = _read_npz(file)
    states, controls, times = (arrays[key].astype(float) for key in NPZ_KEYS[:3])
    offsets = arrays["offsets"]
    if states.ndim != 2 or controls.ndim != 2 or not len(states) == len(controls) == len(times):
        raise PlanspaceError(
            f"{file}: states {states.shape}, controls {controls.shape} and time {times.shape} must have "
            "two, two and one axes and the same number of rows."
        )
    if offsets.ndim != 1 or len(offsets) < 2 or offsets[0] != 0 or offsets[-1] != len(states):
        raise PlanspaceError(f"{file}: offsets must run from 0 to the number of rows, {len(states)}.")
    if (np.diff(offsets) < 2).any():
        raise PlanspaceError(f"{file}: episode {np.argmin(np.diff(offsets))} has fewer than two states.")
    if info is None:
        names = tuple(f"state{i}" for i in range(states.shape[1]))
        info = StateInfo(names, ("",) * len(names), (), controls.shape[1])
    folder = DemoFolder(out, info, {"imported": file.name, "sha256": file_hash(file)})
    for first in range(folder.next_index, len(offsets) - 1, IMPORT_SHARD_EPISODES):
        last = min(first + IMPORT_SHARD_EPISODES, len(offsets) - 1)
        episodes = []
        for i in range(first, last):
            a, b = int(offsets[i]), int(offsets[i + 1])
            episodes.append(
                Episode(
                    states=states[a:b],
                    controls=controls[a : b - 1],
                    times=times[a:b] - times[a],
                    goal=np.full(states.shape[1], np.nan),
                    success=False,
                    index=i,
                    seed=0,
                )
            )
        folder.append(episodes, last)
    return folder


def export_npz(demos: Demos, file: Path) -> None:
    """Writes demonstrations as an NPZ archive that `import_npz` reads; the last control of each is zero."""
    controls = np.zeros((len(demos.states), demos.info.num_controls))
    controls[_rows_with_control(demos)] = demos.controls
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, states=demos.states, controls=controls, time=demos.times, offsets=demos.offsets
    )
    write_bytes(file, buffer.getvalue())


def _rows_with_control(demos: Demos) -> np.ndarray:
    has_control = np.ones(len(demos.states), dtype=bool)
    has_control[demos.offsets[1:] - 1] = False
    return has_control


def _read_npz(file: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(io.BytesIO(read_bytes(file)), allow_pickle=False) as archive:
            missing = [key for key in NPZ_KEYS if key not in archive]
            if missing:
                raise PlanspaceError(f"{file} has no array {missing[0]!r}; it needs {', '.join(NPZ_KEYS)}.")
            return {key: archive[key] for key in NPZ_KEYS}
    except (ValueError, zipfile.BadZipFile, EOFError, AttributeError) as error:
        raise PlanspaceError(f"{file} is not a readable NPZ archive of plain arrays ({error}).") from error
