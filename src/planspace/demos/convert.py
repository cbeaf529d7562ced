"""Demonstrations from and to other formats; the kind of a file is told by its name."""

import io
import itertools
import re
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planspace.demos.csv_files import csv_text, read_csv
from planspace.demos.dataset import MANIFEST, MINARI_PREFIX, DemoFolder, Demos, Episode, StateInfo
from planspace.demos.layouts_2020 import read_json_paths, read_out_paths
from planspace.demos.minari import read_minari, write_minari
from planspace.demos.recording import (
    Imported,
    ImportOptions,
    anonymous_info,
    check_rising,
    recorded,
    refuse,
)
from planspace.demos.resample import common_step, resample, with_continuous_angles
from planspace.errors import PlanspaceError, UsageError
from planspace.store import file_hash, json_hash, read_bytes, write_bytes

NPZ_KEYS = ("states", "controls", "time", "offsets")
IMPORT_SHARD_EPISODES = 256
SUFFIXES = (".npz", ".csv", ".json", ".out")
IMPORT_KINDS = "FILE.npz, FILE.csv, minari:ID, or a folder of .csv, .json or .out files"
EXPORT_KINDS = "FILE.npz, FILE.csv or minari:ID"


# --- import -----------------------------------------------------------------------------------------


def import_demos(
    sources: Sequence[str], out: Path, info: StateInfo | None, options: ImportOptions
) -> DemoFolder:
    """Makes a dataset of demonstrations in another format, and says on standard error what it assumed.

    Everything is read and checked before the folder is made. Circular angles are made continuous and end in
    (-pi, pi]; where time steps are uneven, all demonstrations are brought to one step.

    Args:
        sources: one of `IMPORT_KINDS`, or several files of one kind.
        out: the dataset folder to make.
        info: what the states are, if that is known: a planning problem's.
        options: how to read the source.

    Raises:
        UsageError: the kind is not known, or an option does not fit it.
        PlanspaceError: the source cannot be read (file, row and column are named).
    """
    if len(sources) == 1 and sources[0].startswith(MINARI_PREFIX):
        dataset_id = sources[0].removeprefix(MINARI_PREFIX)
        refuse(options, sources[0], states=True, controls=False, dt=True)
        origin = {"imported": sources[0]}
        return _store(read_minari(dataset_id, info, options), out, origin, options)
    files = _files(sources)
    kind = files[0].suffix.lower()
    named = kind in (".csv", ".json")
    refuse(options, _name(sources), states=named, controls=named, dt=kind == ".csv")
    if kind == ".npz":
        imported = _read_npz(files[0], info)
    elif kind == ".csv":
        imported = read_csv(files, info, options)
    elif kind == ".json":
        imported = read_json_paths(files, info, options)
    else:
        imported = read_out_paths(files, info)
    origin = {"imported": _name(sources), "sha256": _hash(files)}
    return _store(imported, out, origin, options)


def import_npz(file: Path, out: Path, info: StateInfo | None) -> DemoFolder:
    """Imports an NPZ archive just as it is: uneven time steps and wound-up angles are kept.

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
    return import_demos([str(file)], out, info, ImportOptions(as_recorded=True))


def _files(sources: Sequence[str]) -> list[Path]:
    """The files of the sources, all of one kind, numbers in their names in numerical order."""
    if not sources:
        raise UsageError(f"which source? It may be {IMPORT_KINDS}.")
    files: list[Path] = []
    for source in map(Path, sources):
        if (source / MANIFEST).exists():
            raise UsageError(f"{source} is a planspace dataset already; there is nothing to import.")
        inside = [f for f in source.glob("*") if f.suffix.lower() in SUFFIXES and f.name[0] != "."]
        files += sorted(inside, key=_natural_order) if source.is_dir() else [source]
    kinds = sorted({file.suffix.lower() for file in files})
    if not files or any(kind not in SUFFIXES for kind in kinds):
        raise UsageError(f"{_name(sources)} is no source of demonstrations; it may be {IMPORT_KINDS}.")
    if len(kinds) > 1:
        raise UsageError(f"{_name(sources)} holds {' and '.join(kinds)} files; import one kind at a time.")
    if kinds == [".npz"] and len(files) > 1:
        raise UsageError(f"{_name(sources)} holds {len(files)} NPZ archives; import one at a time.")
    return files


def _natural_order(file: Path) -> list[tuple[int, str]]:
    """`plan_2` before `plan_10`."""
    return [(int(part) if part.isdigit() else -1, part) for part in re.split(r"(\d+)", file.name)]


def _name(sources: Sequence[str]) -> str:
    first = Path(sources[0]).name
    return first if len(sources) == 1 else f"{first} and {len(sources) - 1} more"


def _hash(files: Sequence[Path]) -> str:
    if len(files) == 1:
        return file_hash(files[0])
    return json_hash({"files": [[file.name, file_hash(file)] for file in files]})


def minari_demos(source: str) -> Demos:
    """Demonstrations of `minari:ID` as they would be imported, without a folder.

    Raises:
        UsageError: its name is malformed, or its states have to be told; `planspace demos import` can.
        PlanspaceError: it cannot be read.
    """
    options = ImportOptions()
    imported = read_minari(source.removeprefix(MINARI_PREFIX), None, options)
    return Demos.from_episodes(imported.info, _in_order(imported, source, options))


def _in_order(imported: Imported, source: str, options: ImportOptions) -> list[Episode]:
    """Checks everything, brings angles and steps in order, and says on standard error what was assumed."""
    info, episodes, notices = imported.info, imported.episodes, list(imported.notices)
    try:
        Demos.from_episodes(info, episodes)
    except PlanspaceError as error:
        raise PlanspaceError(f"{source}: {error}") from error
    if not options.as_recorded:
        keep = imported.keep_angles
        episodes = [with_continuous_angles(e, info, keep_windings=keep) for e in episodes]
        step = common_step(episodes, info)
        if step is not None:
            resampled = [resample(e, info, step) for e in episodes]
            count = sum(new is not old for new, old in zip(resampled, episodes, strict=True))
            notices.append(f"resampled {count} of {len(episodes)} demonstrations to a step of {step:.6g} s")
            episodes = resampled
    for notice in notices:
        print(notice, file=sys.stderr)
    return episodes


def _store(imported: Imported, out: Path, origin: dict[str, str], options: ImportOptions) -> DemoFolder:
    """Makes the folder, once everything is in order."""
    info, episodes = imported.info, _in_order(imported, origin["imported"], options)
    content = Demos.from_episodes(info, episodes).hash
    folder = DemoFolder(out, info, {**origin, "problem": info.problem, "content": content})
    for first in range(folder.next_index, len(episodes), IMPORT_SHARD_EPISODES):
        last = min(first + IMPORT_SHARD_EPISODES, len(episodes))
        folder.append(episodes[first:last], last)
    return folder


# --- export -----------------------------------------------------------------------------------------


def export_demos(demos: Demos, target: str) -> Path:
    """Writes demonstrations in another format; `import_demos` reads each back to the same numbers.

    Args:
        demos: the demonstrations.
        target: one of `EXPORT_KINDS`.

    Returns:
        What was written.

    Raises:
        UsageError: the kind is not known.
        PlanspaceError: it cannot be written.
    """
    if target.startswith(MINARI_PREFIX):
        return write_minari(demos, target.removeprefix(MINARI_PREFIX))
    file = Path(target)
    if file.suffix.lower() == ".npz":
        export_npz(demos, file)
    elif file.suffix.lower() == ".csv":
        write_bytes(file, csv_text(demos).encode())
    else:
        raise UsageError(
            f"{target} has no kind that demonstrations are written in; it may be {EXPORT_KINDS}."
        )
    return file


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


# --- NPZ --------------------------------------------------------------------------------------------


def _read_npz(file: Path, info: StateInfo | None) -> Imported:
    arrays = _npz_arrays(file)
    states, controls, times = (arrays[key].astype(float) for key in NPZ_KEYS[:3])
    offsets = arrays["offsets"]
    axes = (states.ndim, controls.ndim, times.ndim)
    if axes != (2, 2, 1) or not len(states) == len(controls) == len(times):
        raise PlanspaceError(
            f"{file}: states {states.shape}, controls {controls.shape} and time {times.shape} must have "
            "two, two and one axes and the same number of rows."
        )
    if offsets.ndim != 1 or len(offsets) < 2 or offsets[0] != 0 or offsets[-1] != len(states):
        raise PlanspaceError(f"{file}: offsets must run from 0 to the number of rows, {len(states)}.")
    if (np.diff(offsets) < 2).any():
        raise PlanspaceError(f"{file}: episode {np.argmin(np.diff(offsets))} has fewer than two states.")
    episodes = []
    for i, (a, b) in enumerate(itertools.pairwise(offsets)):
        check_rising(times[a:b], lambda k, i=i, a=a: f"{file}, episode {i}, row {a + k}")
        episodes.append(recorded(states[a:b], controls[a : b - 1], times[a:b], i))
    return Imported(info or anonymous_info(states.shape[1], controls.shape[1]), episodes)


def _npz_arrays(file: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(io.BytesIO(read_bytes(file)), allow_pickle=False) as archive:
            missing = [key for key in NPZ_KEYS if key not in archive]
            if missing:
                raise PlanspaceError(f"{file} has no array {missing[0]!r}; it needs {', '.join(NPZ_KEYS)}.")
            arrays = {key: archive[key] for key in NPZ_KEYS}
    except (ValueError, zipfile.BadZipFile, EOFError, AttributeError) as error:
        raise PlanspaceError(f"{file} is not a readable NPZ archive of plain arrays ({error}).") from error
    for key, array in arrays.items():
        if array.dtype.kind not in ("iu" if key == "offsets" else "iuf"):
            raise PlanspaceError(f"{file}: the array {key!r} is of type {array.dtype}; numbers are needed.")
    return arrays
