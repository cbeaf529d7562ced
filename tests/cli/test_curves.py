"""`planspace curves`."""

import shutil
from pathlib import Path

import pytest

from planspace.rl.saved_policy import DESCRIPTION
from planspace.storage.json_files import read_sealed, write_sealed

from .calls import call

RUN = Path(__file__).parents[1] / "golden" / "2026-11" / "run"


@pytest.mark.parametrize("changed", [{"task": "reacher"}, {"reward": "sparse"}])
def test_returns_of_two_kinds_are_not_drawn_together(
    changed: dict[str, str], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    other = tmp_path / "other"
    shutil.copytree(RUN, other)
    settings = read_sealed(RUN / DESCRIPTION)
    write_sealed(other / DESCRIPTION, settings | changed)
    code, _, err = call(capsys, "curves", RUN, other, "--out", tmp_path / "both")
    assert code == 2 and "these returns cannot be compared" in err
    task, reward = changed.get("task", settings["task"]), changed.get("reward", settings["reward"])
    assert f"{other} is {task} with the {reward} reward" in err
    assert not (tmp_path / "both").exists()


def test_runs_of_one_task_are_drawn(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    again = tmp_path / "again"
    shutil.copytree(RUN, again)
    assert call(capsys, "curves", RUN, again, "--out", tmp_path / "both")[0] == 0
    assert (tmp_path / "both" / "curves.png").exists()
