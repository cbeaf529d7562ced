"""Demonstrations from and to other formats; the kind of a file is told by its name.

A source is read a demonstration at a time and laid down in a folder of its own, and only what is in order
throughout is copied to the dataset: it may be larger than memory, and a bad source leaves nothing behind.
"""

import itertools
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from planspace.demos.csv_files import csv_text, read_csv
from planspace.demos.dataset import Demos, Episode, StateInfo, check_episode
from planspace.demos.folder import MANIFEST, MINARI_PREFIX, DemoFolder, StoredDemos
from planspace.demos.layouts_2020 import read_json_paths, read_out_paths
from planspace.demos.minari import read_minari, write_minari
from planspace.demos.npz_files import export_npz, read_npz
from planspace.demos.recording import Imported, ImportOptions, refuse
from planspace.demos.resample import common_step, has_step, resample, with_continuous_angles
from planspace.errors import PlanspaceError, UsageError, printable
from planspace.progress import progress_over
from planspace.storage.checks import explain_memory_error
from planspace.storage.files import TEMPORARY_PREFIX, file_hash, make_folder, write_bytes
from planspace.storage.json_files import json_hash
from planspace.storage.runs import lock_folder

SHARD_EPISODES, SHARD_STATES = 256, 100_000
"""An imported shard ends with so many demonstrations, or the one that brings it to so many states."""
STAGE, RECORDED, EVEN = f"{TEMPORARY_PREFIX}import", "recorded", "even"
"""Where demonstrations are laid down in the folder to be: as recorded, and brought to one time step."""
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
    with _in_bounds(" ".join(sources)):
        imported, origin = _read(sources, info, options)
        return _store(imported, out, origin, options)


def _read(
    sources: Sequence[str], info: StateInfo | None, options: ImportOptions
) -> tuple[Imported, dict[str, str]]:
    """What the sources hold, and how the dataset is to name them."""
    if len(sources) == 1 and sources[0].startswith(MINARI_PREFIX):
        dataset_id = sources[0].removeprefix(MINARI_PREFIX)
        refuse(options, sources[0], states=True, controls=False, dt=True)
        return read_minari(dataset_id, info, options), {"imported": sources[0]}
    files = _files(sources)
    kind = files[0].suffix.lower()
    named = kind in (".csv", ".json")
    refuse(options, _name(sources), states=named, controls=named, dt=kind == ".csv")
    if kind == ".npz":
        imported = read_npz(files[0], info)
    elif kind == ".csv":
        imported = read_csv(files, info, options)
    elif kind == ".json":
        imported = read_json_paths(files, info, options)
    else:
        imported = read_out_paths(files, info)
    return imported, {"imported": _name(sources), "sha256": _hash(files)}


@contextmanager
def _in_bounds(source: str) -> Iterator[None]:
    """Numbers that overflow are refused once they are not finite, without a warning before; as is a source
    that memory does not hold.
    """
    with explain_memory_error(source), np.errstate(over="ignore", invalid="ignore"):
        yield


def import_npz(file: Path, out: Path, info: StateInfo | None) -> DemoFolder:
    """Imports an NPZ archive just as it is: uneven steps and wound-up angles are kept; see `read_npz`."""
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
    try:
        stage = tempfile.TemporaryDirectory(prefix="planspace-")
    except OSError as error:
        raise PlanspaceError(
            f"reading {source} takes a folder for temporary files: {error.strerror}; set TMPDIR to one."
        ) from error
    with stage, _in_bounds(source):
        imported = read_minari(source.removeprefix(MINARI_PREFIX), None, options)
        return _in_order(imported, source, options, Path(stage.name)).load()


def _store(imported: Imported, out: Path, origin: dict[str, str], options: ImportOptions) -> DemoFolder:
    """Makes the dataset, once everything is in order."""
    with _stage_in(out) as stage:
        demos = _in_order(imported, origin["imported"], options, stage)
        about = {**origin, "problem": demos.info.problem, "content": demos.hash}
        folder = DemoFolder(out, demos.info, about)
        missing = itertools.islice(demos.episodes(), folder.num_episodes, None)
        _append_all(
            folder, progress_over(missing, "store", unit="demo", total=len(demos) - folder.num_episodes)
        )
    return folder


@contextmanager
def _stage_in(out: Path) -> Iterator[Path]:
    """A folder in `out` for what is not finished, gone afterwards, as is `out` if nothing came of it."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    stage = make_folder(out) / STAGE
    try:
        if stage.is_symlink():  # not ours: what it leads to is left alone
            stage.unlink()
        with lock_folder(make_folder(stage)):
            for name in (RECORDED, EVEN):  # what a kill left behind
                _remove(stage / name)
            try:
                yield stage
            finally:
                shutil.rmtree(stage, ignore_errors=True)
    finally:
        with suppress(OSError):  # it is not empty
            for folder in made:
                folder.rmdir()


def _remove(folder: Path) -> None:
    if folder.is_symlink():
        folder.unlink()
    else:
        shutil.rmtree(folder, ignore_errors=True)


def _in_order(imported: Imported, source: str, options: ImportOptions, stage: Path) -> StoredDemos:
    """Lays everything down checked, angles and steps in order; says on standard error what was assumed."""
    info, notices = imported.info, list(imported.notices)
    if not info.names:
        raise PlanspaceError(f"{source}: its states have no numbers.")
    checked = progress_over(_checked(imported, source, options), "read", unit="demo")
    demos = _lay_down(stage / RECORDED, source, info, checked)
    step = None if options.as_recorded else common_step(lambda: map(_steps, demos.shards()), info)
    if step is not None:
        count = sum(not has_step(episode, step) for episode in demos.episodes())
        notices.append(f"resampled {count} of {len(demos)} demonstrations to a step of {step:.6g} s")
        resampled = (resample(episode, info, step) for episode in demos.episodes())
        resampled = progress_over(resampled, "resample", unit="demo", total=len(demos))
        demos = _lay_down(stage / EVEN, source, info, resampled)
        _remove(stage / RECORDED)
    for notice in notices:
        print(printable(notice), file=sys.stderr)
    return demos


def _checked(imported: Imported, source: str, options: ImportOptions) -> Iterator[Episode]:
    for episode in imported.episodes:
        try:
            check_episode(imported.info, episode)
        except PlanspaceError as error:
            raise PlanspaceError(f"{source}: {error}") from error
        if not options.as_recorded:
            episode = with_continuous_angles(episode, imported.info, keep_windings=imported.keep_angles)
        yield episode


def _lay_down(path: Path, source: str, info: StateInfo, episodes: Iterable[Episode]) -> StoredDemos:
    folder = DemoFolder(path, info, {})
    _append_all(folder, episodes)
    if folder.num_episodes == 0:
        raise PlanspaceError(f"{source}: there are no demonstrations.")
    return StoredDemos(path)


def _append_all(folder: DemoFolder, episodes: Iterable[Episode]) -> None:
    shard: list[Episode] = []
    num_states = 0
    for episode in episodes:
        shard.append(episode)
        num_states += len(episode.states)
        if len(shard) == SHARD_EPISODES or num_states >= SHARD_STATES:
            folder.append(shard, folder.num_episodes + len(shard))
            shard, num_states = [], 0
    if shard:
        folder.append(shard, folder.num_episodes + len(shard))


def _steps(demos: Demos) -> np.ndarray:
    """How long each step lasts [s]."""
    within = np.ones(len(demos.times) - 1, dtype=bool)
    within[demos.offsets[1:-1] - 1] = False
    return np.diff(demos.times)[within]


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
