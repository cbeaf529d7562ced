"""Killed commands, run again, end with the same content as undisturbed ones."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
KILLS = 6


@pytest.mark.nightly
def test_killed_commands_end_with_the_same_content(tmp_path: Path) -> None:
    """The killed commands also get another hash seed, locale, folder and number of cores.

    `tests/study/test_run.py` kills a study.
    """
    words = ["--scale", "small", "--only", "plan,embed,train", "--kills", str(KILLS), "--out", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "kills.py"), *words],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split("|")[1:-1] for line in done.stdout.splitlines() if line.endswith("yes |")]
    assert [row[0].strip() for row in rows] == ["plan", "embed", "train"]
    assert all(int(row[1]) == KILLS for row in rows), done.stdout
