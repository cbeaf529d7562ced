"""Import demonstrations from other file formats, and export them.

A source is read one demonstration at a time into a temporary folder. The dataset is written when all
demonstrations have been checked, so a source may be larger than memory and an invalid one leaves no files.
"""

import itertools
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.folder import DemoFolder
from planspace.demos.formats.format import Format
from planspace.demos.formats.registry import export_patterns, find_format, import_patterns
from planspace.demos.manifest import MANIFEST, DatasetSettings
from planspace.demos.prepare import DECLARED, RECORDED, RESAMPLED, Prepared, prepare, remove
from planspace.demos.recording import Imported, ImportOptions, source_name
from planspace.demos.state_info import StateInfo
from planspace.demos.tables import import_tables
from planspace.errors import PlanspaceError, UsageError, printable
from planspace.progress import progress_over
from planspace.storage.checks import explain_memory_error
from planspace.storage.files import TEMPORARY_PREFIX, file_hash, make_folder
from planspace.storage.json_files import json_hash
from planspace.storage.runs import lock_folder

STAGING = f"{TEMPORARY_PREFIX}import"
"""The temporary folder inside the new dataset."""


# --- import -----------------------------------------------------------------------------------------


def import_demos(
    sources: Sequence[str],
    out: Path,
    info: StateInfo | None,
    options: ImportOptions,
    show: Callable[[str], None] = lambda table: None,
) -> DemoFolder:
    """Make a dataset from demonstrations in another format.

    Angles on a circle are made continuous and end in (-pi, pi]. If time steps are uneven, all demonstrations
    are resampled to one time step. Assumptions are reported on standard error.

    Args:
        sources: a source that one of `FORMATS` recognises, several files of one format, or a folder of them.
        out: the dataset folder to make.
        info: the states of the planning problem; None if there is no problem.
        options: how to read the source.
        show: called with a table of the columns of the source and their use, before the dataset is written.

    Raises:
        UsageError: no format recognises the source, or an option does not fit the format.
        PlanspaceError: the source cannot be read; the message names the file, row and column.
    """
    with _quiet_overflow(" ".join(sources)):
        fmt, sources, name = _find_sources(sources)
        imported = _read(fmt, sources, info, options)
        settings = DatasetSettings(imported=name)
        if fmt.is_file:
            settings["sha256"] = _hash(list(map(Path, sources)))
        return _store(imported, out, settings, options, show)


def import_npz(file: Path, out: Path, info: StateInfo | None) -> DemoFolder:
    """Import an NPZ archive unchanged: uneven time steps and full turns of angles are kept."""
    return import_demos([str(file)], out, info, ImportOptions(as_recorded=True))


def preview(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> tuple[str, int]:
    """Read and check sources as `import_demos` would, and report the same, without making a dataset.

    Args:
        sources: as for `import_demos`.
        info: the states of the planning problem; None if there is no problem.
        options: how to read the source.

    Returns:
        The table of columns, and the number of demonstrations that would be stored.
    """
    tables: list[str] = []
    with _temporary_folder(" ".join(sources)) as staging:
        fmt, sources, name = _find_sources(sources)
        demos = _prepare(_read(fmt, sources, info, options), name, options, staging, tables.append).demos
        return tables[0], len(demos)


def load_source(source: str) -> Demos:
    """Read a source as `import_demos` would, without making a dataset folder.

    Raises:
        UsageError: no format recognises the source, or its states need options of `planspace demos import`.
        PlanspaceError: the source cannot be read.
    """
    options = ImportOptions()
    with _temporary_folder(source) as staging:
        fmt, sources, name = _find_sources([source])
        imported = _read(fmt, sources, None, options)
        return _prepare(imported, name, options, staging, lambda table: None).demos.load()


@contextmanager
def _temporary_folder(source: str) -> Iterator[Path]:
    """A temporary folder in which a source is prepared."""
    try:
        staging = tempfile.TemporaryDirectory(prefix="planspace-")
    except OSError as error:
        raise PlanspaceError(
            f"reading {source} needs a folder for temporary files: {error.strerror}; set TMPDIR to a folder "
            "that can be written."
        ) from error
    with staging, _quiet_overflow(source):
        yield Path(staging.name)


@contextmanager
def _quiet_overflow(source: str) -> Iterator[None]:
    """Silence NumPy's warnings about overflow, because numbers that are not finite are refused anyway."""
    with explain_memory_error(source), np.errstate(over="ignore", invalid="ignore"):
        yield


def _read(fmt: Format, sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    found = fmt.read(sources, info, options)
    return found if isinstance(found, Imported) else import_tables(found, info, options)


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


def _store(
    imported: Imported,
    out: Path,
    settings: DatasetSettings,
    options: ImportOptions,
    show: Callable[[str], None],
) -> DemoFolder:
    """Make the dataset after all demonstrations have been checked."""
    with _staging_folder(out) as staging:
        prepared = _prepare(imported, settings.get("imported", ""), options, staging, show)
        demos = prepared.demos
        settings = settings | DatasetSettings(problem=demos.info.problem, content=demos.hash)
        if prepared.splits:
            settings["split"] = prepared.splits
        folder = DemoFolder(out, demos.info, settings)
        missing = itertools.islice(demos.episodes(), folder.num_episodes, None)
        folder.extend(progress_over(missing, "store", unit="demo", total=len(demos) - folder.num_episodes))
    return folder


def _prepare(
    imported: Imported, source: str, options: ImportOptions, staging: Path, show: Callable[[str], None]
) -> Prepared:
    prepared = prepare(imported, source, options, staging, show)
    for notice in prepared.notices:
        print(printable(notice), file=sys.stderr)
    return prepared


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
            for name in (RECORDED, DECLARED, RESAMPLED):  # left by a killed import
                remove(staging / name)
            try:
                yield staging
            finally:
                shutil.rmtree(staging, ignore_errors=True)
    finally:
        with suppress(OSError):  # not empty
            for folder in made:
                folder.rmdir()


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
