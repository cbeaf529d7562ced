"""What does not fit is refused where a Gymnasium environment is a task, and broken environments are named."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import planspace as ps
from planspace.cli import main
from planspace.errors import PlanspaceError, UsageError
from planspace.rl.config import TrainConfig
from planspace.rl.play import make_env
from planspace.rl.training import train_policies
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.tasks import gymnasium_ids
from planspace.tasks.catalog import find_task
from planspace.tasks.gymnasium import GymTask, find_training_task, parse_gym_task

from . import tiny_gym_envs  # noqa: F401  registers them

PUCK = GymTask("tiny/Puck-v0")
PENDULUM = "gym:InvertedPendulum-v5"
CONFIG = TrainConfig(num_seeds=2, steps=600, batch_steps=100)


REFUSED: dict[str, tuple[Any, dict, str]] = {
    "similar id": (
        "gym:Hoper-v5",
        {},
        "gym:Hoper-v5: Environment `Hoper` doesn't exist. Did you mean: `Hopper`?",
    ),
    "version": ("gym:InvertedPendulum-v77", {}, "Environment version `v77` .* doesn't exist"),
    "no version": ("gym:InvertedPendulum", {}, "gym:InvertedPendulum: No registered env with id"),
    "malformed": ("gym:a b", {}, "gym:a b: Malformed environment ID: a b."),
    "empty": ("gym:", {}, "the id of a GymTask must be text such as 'Hopper-v5', got ''"),
    "namespace": ("gym:nowhere/X-v0", {}, "Namespace nowhere not found"),
    "module": ("gym:no_such_module:X-v0", {}, "importing no_such_module failed: ModuleNotFoundError"),
    "choices": ("gym:CartPole-v1", {}, r"has the actions Discrete\(2\); .* only on a Box of floats"),
    "own choices": ("gym:tiny/Chooser-v0", {}, "has the actions Discrete"),
    "observed choice": ("gym:tiny/Reader-v0", {}, r"observes Discrete\(2\); only a Box, or a Dict of Boxes"),
    "no limit": ("gym:tiny/Endless-v0", {}, "has no time limit: set `max_episode_steps` of a GymTask"),
    "arguments": (GymTask("tiny/Puck-v0", {"pull": 1}), {}, "cannot be made: TypeError: .*pull"),
    "names": (
        replace(PUCK, obs_names=("a", "b")),
        {},
        r"`obs_names` must be 3 different names, .*got \('a', 'b'\)",
    ),
    "same names": (replace(PUCK, obs_names=("a", "b", "b")), {}, "must be 3 different names"),
    "trig": (PUCK, {"obs": "trig"}, "unknown observation type of gym:tiny/Puck-v0 'trig'. Known: raw."),
    "wrapped": (PUCK, {"obs": "wrapped"}, "unknown observation type of gym:tiny/Puck-v0 'wrapped'"),
    "sparse": (PUCK, {"reward": "sparse"}, "unknown reward type of gym:tiny/Puck-v0 'sparse'. Known: dense."),
    "2020": (PUCK, {"reward": "2020"}, "unknown reward type of gym:tiny/Puck-v0 '2020'"),
    "shaping": (PUCK, {"shaping": "raw"}, "shaping needs a goal, but gym:tiny/Puck-v0 has none"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    task, change, message = REFUSED[case]
    with pytest.raises(UsageError, match=message) as caught:
        train_policies(task, replace(CONFIG, **change), out=tmp_path / "run")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("task", "workers", "message"),
    [
        ("cartpole", 2, "--env-workers 2 is for Gymnasium environments, but cartpole is one batch"),
        (PUCK, -1, "`env_workers` must be 0 or more, got -1"),
    ],
)
def test_workers_that_do_not_fit_are_refused(task: Any, workers: int, message: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=message):
        train_policies(task, CONFIG, env_workers=workers, out=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ("error", "gym:tiny/Puck-v0 failed in `step`: RuntimeError: the rail broke"),
        ("nan", "gym:tiny/Puck-v0 returned a number that is not finite: puck_0"),
        ("reward", r"gym:tiny/Puck-v0 returned a reward that is not finite \(inf\)"),
    ],
)
def test_a_broken_environment_is_named(broken: str, message: str) -> None:
    with pytest.raises(PlanspaceError, match=message):
        train_policies(replace(PUCK, kwargs={"broken": broken}), CONFIG)
    with pytest.raises(PlanspaceError, match=message):
        train_policies(replace(PUCK, kwargs={"broken": broken}), CONFIG, env_workers=1)


@pytest.mark.parametrize(
    ("kwargs", "plain", "is_read"),
    [
        ({"push": 2, "limits": (0.5, 1.5)}, {"push": 2, "limits": [0.5, 1.5]}, True),
        ({"limits": (0.5, float("inf"))}, {"limits": [0.5, "inf"]}, False),  # JSON has no infinity
        ({"model": "here.xml"}, {"model": "here.xml"}, False),
    ],
)
def test_arguments_are_recorded_and_only_numbers_are_read_back(
    kwargs: dict, plain: dict, is_read: bool
) -> None:
    task = GymTask("tiny/Puck-v0", kwargs)
    assert task.plain()["kwargs"] == plain
    read = parse_gym_task(json.loads(json.dumps(task.plain(), allow_nan=False)))
    assert (read is not None) == is_read
    assert read is None or read.plain() == task.plain()


def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(gymnasium_ids.PROVIDERS, "nowhere/", ("no_such_package",))
    message = r"gym:nowhere/X-v0 needs the package no_such_package: pip install .*\[robots\]'"
    with pytest.raises(PlanspaceError, match=message):
        find_training_task("gym:nowhere/X-v0").horizon  # noqa: B018


def test_what_needs_a_planning_problem_says_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", PENDULUM, "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "is a Gymnasium environment, which has no planning problem: import demonstrations with" in said
    assert f"`planspace train {PENDULUM} --embedding DIR --z augment`" in said and said.count("\n") == 1
    with pytest.raises(UsageError, match="has no planning problem"):
        find_task(PENDULUM)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"id": "canary:Foo-v0"}, "pass the task"),
        ({"kwargs": {"xml_file": "/etc/passwd"}}, "pass the task"),
        ({"id": 3}, "is invalid"),
        ({"kwargs": []}, "is invalid"),
        ({"max_episode_steps": -3}, "is invalid .*`max_episode_steps` must be"),
        ({"id": "InvertedPendulum-v5"}, "was trained on the task"),
    ],
)
def test_a_file_cannot_name_code(change: dict, message: str, tmp_path: Path) -> None:
    run = train_policies(PUCK, CONFIG, out=tmp_path / "run").run
    file = run / "policies.json"
    about = read_sealed(file)
    about["environment"] |= change
    write_sealed(file, {k: v for k, v in about.items() if k != "sha256"})
    with pytest.raises(PlanspaceError, match=message):
        make_env(ps.load_policy(run))
