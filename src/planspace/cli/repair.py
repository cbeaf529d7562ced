"""Sets damaged files aside, so that the command that made a folder makes again what is missing.

Nothing is removed: what is damaged stays beside its place, as damaged-1-NAME. Of a dataset the shards before
the first damaged one are kept, of a log the lines that can be read.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from planspace.demos import folder as demo_folder
from planspace.embed import embedding
from planspace.errors import PlanspaceError, printable
from planspace.rl import history, saved_policy
from planspace.storage import checkpoint
from planspace.storage.arrays import read_arrays
from planspace.storage.files import read_bytes, remove_file, rename_file, write_bytes
from planspace.storage.json_files import read_sealed
from planspace.storage.rows import is_row

PREFIX = "damaged-"
CHECKS: dict[str, Callable[[Path], Any]] = {
    embedding.DESCRIPTION: lambda file: embedding.load_embedding(file.parent),
    saved_policy.DESCRIPTION: lambda file: saved_policy.load_policy(file.parent),
    history.HISTORY: lambda file: history.load_history(file.parent),
    checkpoint.FILE.name: read_arrays,
}
"""What is read of a folder, and how; results of studies, datasets and logs beside these."""
TOGETHER = {
    embedding.DESCRIPTION: (embedding.WEIGHTS,),
    saved_policy.DESCRIPTION: (saved_policy.WEIGHTS, history.HISTORY),
    history.HISTORY: (saved_policy.WEIGHTS, saved_policy.DESCRIPTION),
}
"""Files that are made with one: were they left, the whole would pass for finished."""
MARKS = ("unit.whole",)
"""What says that a folder is finished."""


def repair(folder: Path) -> list[str]:
    """Looks through a folder of ours, and those in it.

    Args:
        folder: a dataset, an embedding, a training, a run or studies.

    Returns:
        A line for each damage that was found.

    Raises:
        PlanspaceError: there is no such folder, or it cannot be written.
    """
    if not folder.is_dir():
        raise PlanspaceError(f"there is no folder {folder}.")
    inner = sorted(path for path in folder.rglob("*") if path.is_dir() and not path.is_symlink())
    return [line for path in (folder, *inner) for line in _repair_one(path)]


def _repair_one(folder: Path) -> Iterator[str]:
    found = [*_unreadable(folder), *_damaged_dataset(folder)]
    for file, error in found:
        for name in (file.name, *TOGETHER.get(file.name, ())):
            if (folder / name).exists():
                _set_aside(folder / name)
        for mark in MARKS:
            remove_file(folder / mark)
        yield error
    if (folder / embedding.LOG).exists():
        yield from _mend_log(folder / embedding.LOG)


def _unreadable(folder: Path) -> Iterator[tuple[Path, str]]:
    checks = [(folder / name, check) for name, check in CHECKS.items()]
    if folder.name == "units":
        checks += [(file, read_sealed) for file in sorted(folder.glob("*.json")) if PREFIX not in file.name]
    for file, check in checks:
        if file.exists():
            try:
                check(file)
            except PlanspaceError as error:
                yield file, str(error)


def _damaged_dataset(folder: Path) -> Iterator[tuple[Path, str]]:
    if not (folder / demo_folder.MANIFEST).exists():
        return
    try:
        damaged = demo_folder.keep_whole_shards(folder)
    except PlanspaceError as error:
        yield folder / demo_folder.MANIFEST, str(error)
        return
    yield from damaged


def _mend_log(log: Path) -> Iterator[str]:
    try:
        lines = read_bytes(log).splitlines(keepends=True)
    except PlanspaceError as error:  # no plain file
        _set_aside(log)
        yield str(error)
        return
    good = [line for line in lines if is_row(line)]
    if len(good) < len(lines):
        _set_aside(log)
        write_bytes(log, b"".join(line if line.endswith(b"\n") else line + b"\n" for line in good))
        yield f"{log} had {len(lines) - len(good)} damaged lines, which were left out."


def _set_aside(file: Path) -> None:
    number = 1
    while (to := file.with_name(f"{PREFIX}{number}-{file.name}")).exists():
        number += 1
    rename_file(file, to)


@dataclass(frozen=True)
class Repair:
    """Look for damaged files and set them aside, so that the command that made a folder can go on."""

    folder: Positional[Annotated[Path, arg(metavar="DIR")]]
    """A dataset, an embedding, a training, a run or studies. Nothing is removed: a damaged file stays there
    as damaged-1-NAME. Of a dataset, the shards before the first damaged one are kept."""

    def __call__(self) -> None:
        """Prints what was damaged."""
        lines = repair(self.folder)
        print("\n".join(map(printable, lines)) or f"nothing in {self.folder} is damaged.")
        if lines:
            print(
                "Damaged files were set aside. The command that made them, run again, makes what is missing."
            )
