"""A study of a task of one's own: its units, its folder, its report, and how it resumes."""

import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from planspace.cli import main
from planspace.errors import UsageError
from planspace.study import grid
from planspace.study.design import Study
from planspace.study.execute import folder_of, is_done
from planspace.study.grid import make_study
from planspace.study.unit import FitUnit, PlansUnit, PolicyUnit
from planspace.tasks.catalog import find_task

from ..tasks.slide_and_spin import TASK
from ..tasks.test_problem_task import CRANE, write

QUICK = CRANE + "settings: {extensions: 256, polish_max_iterations: 10}\n"
TINY = grid.Budget(steps=8000, seeds=2, plans=12, embeddings=2, restarts=1, fit_steps=60)


def names(study: Study, kind: type) -> set[str]:
    return {unit.name for unit in study.units if isinstance(unit, kind)}


def crane_study(folder: Path, text: str, name: str = "crane.yaml") -> Study:
    folder.mkdir(exist_ok=True)
    return make_study("recipe", "smoke", task=write(folder, text, name))


def test_the_recipe_of_a_problem_file(tmp_path: Path) -> None:
    study = crane_study(tmp_path, CRANE)
    labels = ["recipe: sin/cos + z", "sin/cos", "sin/cos + random encoder", "raw"]
    assert [arm.name for arm in study.arms] == [f"crane, TRPO/{label}" for label in labels]
    assert study.question == "How reliably can crane be learned?" and len(study.claims) == 3
    assert study.command == f"planspace study recipe {tmp_path}/crane.yaml --budget smoke"
    assert study.only(["sin/cos"]).command.endswith("crane.yaml --budget smoke --only sin/cos")
    without_angles = crane_study(tmp_path, CRANE + "task: {observation: trig}\n")
    labels = ["recipe: raw + z", "raw + random encoder", "raw"]
    assert [arm.label for arm in without_angles.arms] == labels


def test_units_depend_on_the_content_of_the_task(tmp_path: Path) -> None:
    first = crane_study(tmp_path, CRANE)
    again = crane_study(tmp_path / "elsewhere", CRANE)
    assert [unit.name for unit in again.units] == [unit.name for unit in first.units]
    assert again.folder == first.folder
    task = find_task(tmp_path / "crane.yaml")
    assert first.folder == f"recipe-crane-{task.hash[:8]}-smoke"
    policy = first.arms[0].units[0]
    assert policy.spec["task"] == "crane" and policy.spec["task_sha256"] == task.hash

    rewarded = crane_study(tmp_path, CRANE + "task: {reward: sparse}\n")  # plans do not depend on it
    assert rewarded.folder != first.folder
    assert names(rewarded, PlansUnit) == names(first, PlansUnit)
    assert names(rewarded, FitUnit) == names(first, FitUnit)
    assert not names(rewarded, PolicyUnit) & names(first, PolicyUnit)

    moved = crane_study(tmp_path / "moved", CRANE.replace("[-1.0, -0.5", "[-1.1, -0.5"))
    assert not {unit.name for unit in moved.units} & {unit.name for unit in first.units}
    shipped = make_study("recipe", "smoke", task="cartpole")
    same_name = crane_study(tmp_path, CRANE, "cartpole.yaml")
    assert not {unit.name for unit in shipped.units} & {unit.name for unit in same_name.units}
    assert shipped.folder == "recipe-cartpole-smoke" != same_name.folder


def test_a_unit_keeps_its_name_in_another_process(tmp_path: Path) -> None:
    for unit in crane_study(tmp_path, CRANE).units:
        read = pickle.loads(pickle.dumps(unit))
        assert read.name == unit.name and replace(read).name == unit.name


def test_the_shipped_task_of_a_study_may_be_named() -> None:
    named, usual = make_study("recipe", "half", task="cartpole-swingup"), make_study("recipe", "half")
    assert [unit.name for unit in named.units] == [unit.name for unit in usual.units]
    arms = [arm.name for arm in make_study("controls", "half", task="pendulum-swingup").arms]
    assert arms[:2] == ["pendulum-swingup, TRPO/raw", "pendulum-swingup, TRPO/raw + sin/cos"]


def test_what_no_study_can_be_made_of_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"study paper has its own tasks: leave out x\.yaml, or choose rec"):
        make_study("paper", "smoke", task="x.yaml")
    with pytest.raises(UsageError, match="has no planning problem, so a study cannot plan its demonstr"):
        make_study("recipe", "smoke", task=replace(TASK, problem=""))
    with pytest.raises(UsageError, match="unknown task 'cartpol'. Did you mean 'cartpole'"):
        make_study("recipe", "smoke", task="cartpol")


@pytest.mark.nightly
def test_the_command_runs_every_arm_and_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(grid.BUDGETS, "smoke", TINY)
    monkeypatch.chdir(tmp_path)
    write(tmp_path, QUICK)
    command = ["study", "recipe", "crane.yaml", "--budget", "smoke", "--out", "out"]
    assert main(command) == 0
    shown = capsys.readouterr().out
    study = make_study("recipe", "smoke", task="crane.yaml")
    assert "9 of 9 units" in shown and "crane, TRPO" in shown and "the recipe is better than raw" in shown
    folder = tmp_path / "out" / study.folder
    for file in ("report.html", "tables.md"):
        text = (folder / file).read_text()
        assert "There is no return above which the task counts as solved" in text
        assert "half had solved it" not in text and "planspace study recipe crane.yaml --budget smoke" in text
    result = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out" / "units").iterdir()}
    assert main(command) == 0  # nothing is run again
    assert {p.name: p.stat().st_mtime_ns for p in (tmp_path / "out" / "units").iterdir()} == result
    (tmp_path / "out" / "units").rename(tmp_path / "units")
    assert main([*command, "--report"]) == 0  # from results.csv
    assert "crane, TRPO" in capsys.readouterr().out
    assert main(["play", str(folder_of(study.arms[0].units[0], tmp_path / "out")), "--episodes", "1"]) == 0


SCRIPT = """
import signal
from pathlib import Path
from planspace.study import grid
from planspace.study.run import run_study
signal.signal(signal.SIGINT, signal.default_int_handler)  # background processes ignore it by default
grid.BUDGETS["smoke"] = grid.Budget(steps=8000, seeds=2, plans=12, embeddings=2, restarts=1, fit_steps=60)
study = grid.make_study("recipe", "smoke", task="crane.yaml")
print(run_study(study, Path("out"), workers=2))
"""


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_an_interrupted_study_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(grid.BUDGETS, "smoke", TINY)
    study = make_study("recipe", "smoke", task=write(tmp_path, QUICK))
    out, start = tmp_path / "out", [sys.executable, "-c", SCRIPT]
    process = subprocess.Popen(start, cwd=tmp_path, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not any(is_done(unit, out) for unit in study.arms[-1].units) and time.monotonic() < deadline:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) != 0
    done = {unit.name for unit in study.units if is_done(unit, out)}
    assert done and len(done) < len(study.units)
    kept = {name: (out / "units" / f"{name}.json").read_bytes() for name in done}
    finished = subprocess.run(start, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert finished.stdout.strip() == "{}"
    assert all(is_done(unit, out) for unit in study.units)
    assert {name: (out / "units" / f"{name}.json").read_bytes() for name in done} == kept
