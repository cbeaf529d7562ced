"""Repair of folders: damaged files are set aside, so that the command that made the folder can go on.

Nothing is removed: a damaged file is renamed to damaged-1-NAME. A log keeps the lines that can be read.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from planspace.errors import PlanspaceError
from planspace.storage.files import read_bytes, remove_file, rename_file, write_bytes
from planspace.storage.rows import is_row

PREFIX = "damaged-"


class Damage(NamedTuple):
    """A damaged file."""

    file: Path
    message: str
    """The error of reading it."""


@dataclass(frozen=True)
class Check:
    """How to find damage in one kind of file."""

    pattern: str
    """Names of the files, as a glob pattern within a folder."""
    find_damage: Callable[[Path], Iterable[Damage]]
    """Function from a file to the damage in it, or in files that it refers to."""
    set_aside_with: tuple[str, ...] = ()
    """Names of the files that must be set aside too, because without the damaged one the rest would look
    complete."""
    folder: str | None = None
    """Name of the folder that holds the files; by default any."""

    def files_in(self, folder: Path) -> list[Path]:
        """The files in a folder that this check applies to, without those set aside before."""
        if self.folder not in (None, folder.name):
            return []
        return sorted(file for file in folder.glob(self.pattern) if not file.name.startswith(PREFIX))


def unreadable(read: Callable[[Path], object]) -> Callable[[Path], Iterator[Damage]]:
    """Build a `find_damage` that reports a file if reading it fails.

    Args:
        read: function that raises PlanspaceError for a damaged file.
    """

    def find_damage(file: Path) -> Iterator[Damage]:
        try:
            read(file)
        except PlanspaceError as error:
            yield Damage(file, str(error))

    return find_damage


def repair_folder(
    folder: Path, checks: Sequence[Check], *, finished_marks: Sequence[str], logs: Sequence[str]
) -> list[str]:
    """Repair a folder and all folders in it.

    Args:
        folder: the folder.
        checks: what to look for.
        finished_marks: names of the files that mark a folder as finished; removed where damage is found.
        logs: names of the logs with one JSON object per line.

    Returns:
        One line for each damage that was found.

    Raises:
        PlanspaceError: the folder does not exist or cannot be written.
    """
    if not folder.is_dir():
        raise PlanspaceError(f"the folder {folder} does not exist.")
    inner = sorted(path for path in folder.rglob("*") if path.is_dir() and not path.is_symlink())
    lines = []
    for path in (folder, *inner):
        lines += _repair_files(path, checks, finished_marks)
        lines += [line for log in logs if (path / log).exists() for line in _repair_log(path / log)]
    return lines


def _repair_files(folder: Path, checks: Sequence[Check], finished_marks: Sequence[str]) -> list[str]:
    found = [  # look for all damage before anything is moved
        (damage, check)
        for check in checks
        for file in check.files_in(folder)
        for damage in check.find_damage(file)
    ]
    for damage, check in found:
        for name in (damage.file.name, *check.set_aside_with):
            if (folder / name).exists():
                _set_aside(folder / name)
        for mark in finished_marks:
            remove_file(folder / mark)
    return [damage.message for damage, _ in found]


def _repair_log(log: Path) -> Iterator[str]:
    try:
        lines = read_bytes(log).splitlines(keepends=True)
    except PlanspaceError as error:  # not a regular file
        _set_aside(log)
        yield str(error)
        return
    good = [line for line in lines if is_row(line)]
    if len(good) < len(lines):
        _set_aside(log)
        write_bytes(log, b"".join(line if line.endswith(b"\n") else line + b"\n" for line in good))
        yield f"{log} had {len(lines) - len(good)} damaged lines; the repaired log leaves them out."


def _set_aside(file: Path) -> None:
    number = 1
    while (to := file.with_name(f"{PREFIX}{number}-{file.name}")).exists():
        number += 1
    rename_file(file, to)
