"""The name of a shipped planning problem, for every verb that takes a task."""

import json
from pathlib import Path

import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.study import quickstart
from planspace.study.grid import make_study
from planspace.tasks.catalog import TASKS, find_task, task_names
from planspace.tasks.problem_file import shipped_problems
from planspace.tasks.task import Task

from .calls import call


def test_a_name_of_a_task_and_a_problem_means_the_task() -> None:
    assert set(task_names()) == {*TASKS, *shipped_problems()} - {"arm-kinematic"}
    assert find_task("cartpole") is TASKS["cartpole"]
    assert find_task("finger-spin").name == "finger-spin"
    with pytest.raises(UsageError, match="'arm-kinematic' is kinematic"):
        find_task("arm-kinematic")


@pytest.mark.slow
def test_policies_of_a_problem_are_trained_and_played(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "policies"
    tiny = ("--steps", 1000, "--batch-steps", 1000, "--num-seeds", 1)
    code, _, err = call(capsys, "train", "ball-pendulum", "--out", out, *tiny)
    assert code == 0, err
    assert (out / "task" / "ball-pendulum.yaml").is_file()
    for named in ((), ("--task", "ball-pendulum")):
        code, shown, err = call(capsys, "play", out, "--episodes", 1, *named)
        assert code == 0 and "1 episode of ball-pendulum" in shown, err


def test_a_problem_is_controlled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--cost", "reward", "--samples", 8, "--episodes", 1, "--episode-s", 0.1, "--no-film")
    code, out, err = call(capsys, "control", "finger-spin", *options, "--json", "--out", tmp_path / "run")
    assert code == 0, err
    assert json.loads(out)["episodes"] == 1


def test_a_problem_is_studied() -> None:
    study, task = make_study("recipe", "smoke", task="pusher"), find_task("pusher")
    assert study.folder == f"recipe-pusher-{task.hash[:8]}-smoke"
    assert study.arms[0].units[0].needs[0].needs[0].problem_name == "pusher"


def test_a_problem_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stages(task: Task, *_: object) -> None:
        raise PlanspaceError(f"the stages of {task.name} begin")

    monkeypatch.setattr(quickstart, "_run_stages", stages)
    monkeypatch.chdir(tmp_path)
    code, _, err = call(capsys, "run", "pusher", "--budget", "smoke")
    assert code == 1 and "the stages of pusher begin" in err
    assert (tmp_path / "runs" / "pusher-smoke" / "task" / "pusher.yaml").is_file()
