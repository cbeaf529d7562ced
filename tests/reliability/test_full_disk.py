"""A full or read-only file system gives a one-line error, loses nothing, and a rerun ends the same."""

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from planspace.cli import main
from planspace.demos.load import load_demos
from planspace.embed.saved_embedding import load_embedding
from planspace.errors import PlanspaceError
from planspace.rl.history import load_history
from planspace.study.run import run_study

from ..tiny_study import TINY, what_was_found

DISK_BYTES, PAGE = 4 * 2**20, 4096
BALLAST = "ballast"


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A separate file system."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a file system is not allowed here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def leave_free(disk: Path, num_bytes: int) -> None:
    """Fill a file system until this many bytes are free, in whole pages."""
    (disk / BALLAST).unlink(missing_ok=True)
    stat = os.statvfs(disk)
    ballast = max(stat.f_bavail * stat.f_frsize - num_bytes, 0) // PAGE * PAGE
    with open(disk / BALLAST, "wb") as file:
        os.posix_fallocate(file.fileno(), 0, ballast)


def used_bytes(folder: Path) -> int:
    return sum(-(-path.stat().st_size // PAGE) * PAGE for path in folder.rglob("*") if path.is_file())


@dataclass(frozen=True)
class Command:
    words: Callable[[Path], list[str]]
    """Function from the folder of a dataset to the arguments."""
    content: Callable[[Path], Any]


PLAN = "plan cartpole-swingup --num 12 --restarts 1 --settings polish_max_iterations=2"
EMBED = "--steps 300 --batch 64 --seeds 2"
TRAIN = "train cartpole --steps 8000 --seeds 2"
COMMANDS = {
    "plan": Command(lambda demos: PLAN.split(), lambda out: load_demos(out).hash),
    "import": Command(
        lambda demos: ["demos", "import", str(demos.parent / "demos.csv")], lambda out: load_demos(out).hash
    ),
    "embed": Command(
        lambda demos: ["embed", str(demos), *EMBED.split()], lambda out: load_embedding(out).hash
    ),
    "train": Command(
        lambda demos: TRAIN.split(),
        lambda out: {name: array.tobytes() for name, array in load_history(out).items()},
    ),
}
FRACTIONS = (0.0, 0.5, 0.9)
"""How much of a command's output fits on the disk."""


@pytest.fixture
def dataset(demo_folder: Path, tmp_path: Path) -> Path:
    """A dataset, with a CSV export next to it."""
    demos = shutil.copytree(demo_folder, tmp_path / "demos")
    assert main(["demos", "export", str(demos), str(tmp_path / "demos.csv")]) == 0
    return demos


@pytest.mark.parametrize(
    "name",
    [
        "import",
        pytest.param("train", marks=pytest.mark.slow),
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("plan", "embed")),
    ],
)
def test_on_a_full_disk_nothing_is_lost(
    name: str, disk: Path, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command, undisturbed, out = COMMANDS[name], tmp_path / "undisturbed", disk / "out"
    assert main([*command.words(dataset), "--out", str(undisturbed)]) == 0
    for fraction in FRACTIONS:
        leave_free(disk, int(fraction * used_bytes(undisturbed)))
        capsys.readouterr()
        assert main([*command.words(dataset), "--out", str(out)]) == 1
        (line,) = [line for line in capsys.readouterr().err.splitlines() if "No space left" in line]
        assert line.startswith("planspace: cannot write ") and "run the same command again" in line
        (disk / BALLAST).unlink()
        assert main([*command.words(dataset), "--out", str(out)]) == 0
        assert command.content(out) == command.content(undisturbed)
        assert not [path.name for path in disk.rglob(".writing-*") if not path.name.endswith("lock")]
        shutil.rmtree(out)


@pytest.mark.nightly
def test_a_study_on_a_full_disk_continues_when_there_is_room(disk: Path, finished: Path) -> None:
    out = disk / "out"
    leave_free(disk, 0)
    with pytest.raises(PlanspaceError, match="^cannot write .*No space left.*run the same command again"):
        run_study(TINY, out, workers=2)
    leave_free(disk, used_bytes(finished) // 2)
    failed = run_study(TINY, out, workers=2)
    assert any("No space left" in why for why in failed.values())
    assert all("No space left" in why or "a unit that it needs failed" in why for why in failed.values())
    (disk / BALLAST).unlink()
    assert run_study(TINY, out, workers=2) == {}
    assert what_was_found(TINY, out) == what_was_found(TINY, finished)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_read_only_disk_is_named_and_unchanged(
    name: str, disk: Path, dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    capsys.readouterr()
    assert main([*COMMANDS[name].words(dataset), "--out", str(disk / "out")]) == 1
    assert "Read-only file system" in capsys.readouterr().err.splitlines()[-1]
    assert list(disk.iterdir()) == []
