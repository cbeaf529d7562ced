"""Import demonstrations from other file formats, and export them.

A source is read one demonstration at a time into a temporary folder. The dataset is written when all
demonstrations have been checked, so a source may be larger than memory and an invalid one leaves no files.
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

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode, check_episode
from planspace.demos.folder import DemoFolder
from planspace.demos.formats.format import Format
from planspace.demos.formats.registry import export_patterns, find_format, import_patterns
from planspace.demos.manifest import MANIFEST, DatasetSettings
from planspace.demos.recording import Imported, ImportOptions, source_name
from planspace.demos.resample import common_step, has_step, resample, with_continuous_angles
from planspace.demos.state_info import StateInfo
from planspace.demos.stored import StoredDemos
from planspace.errors import PlanspaceError, UsageError, printable
from planspace.progress import progress_over
from planspace.storage.checks import explain_memory_error
from planspace.storage.files import TEMPORARY_PREFIX, file_hash, make_folder
from planspace.storage.json_files import json_hash
from planspace.storage.runs import lock_folder

STAGING, RECORDED, RESAMPLED = f"{TEMPORARY_PREFIX}import", "recorded", "even"
"""The temporary folder inside the new dataset, and its datasets before and after resampling."""


# --- import -----------------------------------------------------------------------------------------


def import_demos(
    sources: Sequence[str], out: Path, info: StateInfo | None, options: ImportOptions
) -> DemoFolder:
    """Make a dataset from demonstrations in another format.

    Angles on a circle are made continuous and end in (-pi, pi]. If time steps are uneven, all demonstrations
    are resampled to one time step. Assumptions are reported on standard error.

    Args:
        sources: a source that one of `FORMATS` recognises, several files of one format, or a folder of them.
        out: the dataset folder to make.
        info: the states of the planning problem; None if there is no problem.
        options: how to read the source.

    Raises:
        UsageError: no format recognises the source, or an option does not fit the format.
        PlanspaceError: the source cannot be read; the message names the file, row and column.
    """
    with _quiet_overflow(" ".join(sources)):
        fmt, sources, name = _find_sources(sources)
        imported = fmt.read(sources, info, options)
        settings = DatasetSettings(imported=name)
        if fmt.is_file:
            settings["sha256"] = _hash(list(map(Path, sources)))
        return _store(imported, out, settings, options)


def import_npz(file: Path, out: Path, info: StateInfo | None) -> DemoFolder:
    """Import an NPZ archive unchanged: uneven time steps and full turns of angles are kept."""
    return import_demos([str(file)], out, info, ImportOptions(as_recorded=True))


def load_source(source: str) -> Demos:
    """Read a source as `import_demos` would, without making a dataset folder.

    Raises:
        UsageError: no format recognises the source, or its states need options of `planspace demos import`.
        PlanspaceError: the source cannot be read.
    """
    options = ImportOptions()
    try:
        staging = tempfile.TemporaryDirectory(prefix="planspace-")
    except OSError as error:
        raise PlanspaceError(
            f"reading {source} needs a folder for temporary files: {error.strerror}; set TMPDIR to a folder "
            "that can be written."
        ) from error
    with staging, _quiet_overflow(source):
        fmt, sources, name = _find_sources([source])
        return _check_and_align(fmt.read(sources, None, options), name, options, Path(staging.name)).load()


@contextmanager
def _quiet_overflow(source: str) -> Iterator[None]:
    """Silence NumPy's warnings about overflow, because numbers that are not finite are refused anyway."""
    with explain_memory_error(source), np.errstate(over="ignore", invalid="ignore"):
        yield


def _find_sources(sources: Sequence[str]) -> tuple[Format, list[str], str]:
    """The format of the sources, all sources (files in natural order), and their name in messages."""
    if not sources:
        raise UsageError(f"give a source to import: {import_patterns()}.")
    name = source_name(sources)
    found = [file for source in sources for file in _expand(source)]
    formats = {fmt.pattern: fmt for fmt in map(find_format, found) if fmt}
    if not found or not all(map(find_format, found)):
        raise UsageError(f"{name} is not a source of demonstrations; expected {import_patterns()}.")
    if len(formats) > 1:
        raise UsageError(f"{name} contains {' and '.join(sorted(formats))}; import one format at a time.")
    (fmt,) = formats.values()
    return fmt, found, name if fmt.is_file else sources[0]


def _expand(source: str) -> list[str]:
    """The files of a known format in a folder; any other source as it is."""
    fmt, path = find_format(source), Path(source)
    if fmt and not fmt.is_file:
        return [source]
    if (path / MANIFEST).exists():
        raise UsageError(f"{source} is already a planspace dataset; there is nothing to import.")
    if not path.is_dir():
        return [source]
    files = [file for file in path.glob("*") if find_format(str(file)) and file.name[0] != "."]
    return list(map(str, sorted(files, key=_natural_order)))


def _natural_order(file: Path) -> list[tuple[int, str]]:
    """Sort key that puts `plan_2` before `plan_10`."""
    return [(int(part) if part.isdigit() else -1, part) for part in re.split(r"(\d+)", file.name)]


def _hash(files: Sequence[Path]) -> str:
    if len(files) == 1:
        return file_hash(files[0])
    return json_hash({"files": [[file.name, file_hash(file)] for file in files]})


# --- checking and storing ---------------------------------------------------------------------------


def _store(imported: Imported, out: Path, settings: DatasetSettings, options: ImportOptions) -> DemoFolder:
    """Make the dataset after all demonstrations have been checked."""
    with _staging_folder(out) as staging:
        demos = _check_and_align(imported, settings.get("imported", ""), options, staging)
        settings = settings | DatasetSettings(problem=demos.info.problem, content=demos.hash)
        folder = DemoFolder(out, demos.info, settings)
        missing = itertools.islice(demos.episodes(), folder.num_episodes, None)
        folder.extend(progress_over(missing, "store", unit="demo", total=len(demos) - folder.num_episodes))
    return folder


@contextmanager
def _staging_folder(out: Path) -> Iterator[Path]:
    """A temporary folder in `out`. Folders made for it are removed if they are empty in the end."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    staging = out / STAGING
    try:
        with lock_folder(out):
            if staging.is_symlink():  # not made by us: remove the link, not its target
                staging.unlink()
            make_folder(staging)
            for name in (RECORDED, RESAMPLED):  # left by a killed import
                _remove(staging / name)
            try:
                yield staging
            finally:
                shutil.rmtree(staging, ignore_errors=True)
    finally:
        with suppress(OSError):  # not empty
            for folder in made:
                folder.rmdir()


def _remove(folder: Path) -> None:
    if folder.is_symlink():
        folder.unlink()
    else:
        shutil.rmtree(folder, ignore_errors=True)


def _check_and_align(imported: Imported, source: str, options: ImportOptions, staging: Path) -> StoredDemos:
    """Store checked demonstrations with continuous angles and even steps; report what was assumed."""
    info, notices = imported.info, list(imported.notices)
    if not info.names:
        raise PlanspaceError(f"{source}: its states are empty.")
    checked = progress_over(_checked(imported, source, options), "read", unit="demo")
    demos = _store_temporarily(staging / RECORDED, source, info, checked)
    step = None if options.as_recorded else common_step(lambda: map(_steps, demos.shards()), info)
    if step is not None:
        count = sum(not has_step(episode, step) for episode in demos.episodes())
        notices.append(f"resampled {count} of {len(demos)} demonstrations to a step of {step:.6g} s")
        resampled = (resample(episode, info, step) for episode in demos.episodes())
        resampled = progress_over(resampled, "resample", unit="demo", total=len(demos))
        demos = _store_temporarily(staging / RESAMPLED, source, info, resampled)
        _remove(staging / RECORDED)
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


def _store_temporarily(path: Path, source: str, info: StateInfo, episodes: Iterable[Episode]) -> StoredDemos:
    folder = DemoFolder(path, info, {})
    folder.extend(episodes)
    if folder.num_episodes == 0:
        raise PlanspaceError(f"{source}: there are no demonstrations.")
    return StoredDemos(path)


def _steps(demos: Demos) -> np.ndarray:
    """Duration of each step [s]."""
    within = np.ones(len(demos.times) - 1, dtype=bool)
    within[demos.offsets[1:-1] - 1] = False
    return np.diff(demos.times)[within]


# --- export -----------------------------------------------------------------------------------------


def export_demos(demos: Demos, target: str) -> Path:
    """Write demonstrations in another format. `import_demos` reads them back with the same numbers.

    Args:
        demos: the demonstrations.
        target: a file name or `minari:ID`; one of `FORMATS` must recognise it and be able to write.

    Returns:
        The path that was written.

    Raises:
        UsageError: no format that can be written recognises the target.
        PlanspaceError: the target cannot be written.
    """
    fmt = find_format(target)
    if fmt is None or fmt.write is None:
        raise UsageError(f"cannot export to {target}; give {export_patterns()}.")
    if demos.trees:
        print(f"{target}: the search trees are not exported", file=sys.stderr)
    return fmt.write(demos, target)
