"""Runs of many episodes, in folders and on the command line."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace import PlanspaceError, UsageError, load_demos
from planspace.control import runs
from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.control.runs import control_into
from planspace.tasks.task_hash import earlier_hash

from ..cli.calls import call

CONFIG = ControlConfig(horizon_s=0.8, samples=16, cost="reward")
PENDULUM = Plant.find("pendulum-swingup")


def control(
    out: Path, num: int, config: ControlConfig = CONFIG, *, workers: int = 0, seconds: float = 1.0
) -> runs.ControlSummary:
    return control_into(PENDULUM, None, config, out, num=num, seed=0, episode_s=seconds, workers=workers)


@pytest.mark.slow
def test_a_run_continues_and_ends_like_one_that_was_not_interrupted(tmp_path: Path) -> None:
    whole = control(tmp_path / "whole", 3)
    control(tmp_path / "parts", 1)
    parts = control(tmp_path / "parts", 3)
    assert replace(parts, real_time=0.0) == replace(whole, real_time=0.0)
    assert (
        load_demos(tmp_path / "whole" / "episodes").hash == load_demos(tmp_path / "parts" / "episodes").hash
    )


def test_episodes_start_where_they_are_told(tmp_path: Path) -> None:
    starts = np.array([[0.1, 0.0], [-0.2, 0.5]])
    given = {"num": 2, "seed": 0, "episode_s": 0.2, "workers": 0}
    control_into(PENDULUM, None, CONFIG, tmp_path, starts=starts, **given)
    episodes = load_demos(tmp_path / "episodes")
    np.testing.assert_array_equal([episodes.episode(i).states[0] for i in (0, 1)], starts)
    control_into(PENDULUM, None, CONFIG, tmp_path, starts=starts, **given)  # nothing is left to do
    with pytest.raises(UsageError, match="2 episodes need as many starts of 2 numbers"):
        control_into(PENDULUM, None, CONFIG, tmp_path, starts=starts[:1], **given)
    with pytest.raises(PlanspaceError, match="starts"):
        control_into(PENDULUM, None, CONFIG, tmp_path, starts=-starts, **given)


def test_a_run_that_recorded_an_earlier_hash_of_the_task_goes_on(tmp_path: Path) -> None:
    control(tmp_path, 1, seconds=0.1)
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["task_sha256"] == PENDULUM.task.hash != earlier_hash(PENDULUM.task)
    for recorded in (earlier_hash(PENDULUM.task), "0"):
        (tmp_path / "config.json").write_text(json.dumps({**config, "task_sha256": recorded}))
        if recorded == "0":
            with pytest.raises(PlanspaceError, match="task_sha256"):
                control(tmp_path, 2, seconds=0.1)
        else:
            assert control(tmp_path, 2, seconds=0.1).episodes == 2


@pytest.mark.nightly
def test_a_kill_between_the_two_datasets_stores_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    control(tmp_path / "whole", 2, seconds=4.0)

    class Killed(Exception):
        pass

    append = runs.DemoFolder.append

    def killed(self: runs.DemoFolder, episodes: list, next_index: int) -> None:
        if self.path.name == "episodes" and next_index == 2:
            raise Killed
        append(self, episodes, next_index)

    monkeypatch.setattr(runs.DemoFolder, "append", killed)
    with pytest.raises(Killed):
        control(tmp_path / "killed", 2, seconds=4.0)
    monkeypatch.undo()
    control(tmp_path / "killed", 2, seconds=4.0)
    for name in ("episodes", "demos"):
        assert load_demos(tmp_path / "whole" / name).hash == load_demos(tmp_path / "killed" / name).hash
    assert len((tmp_path / "killed" / "log.jsonl").read_text().splitlines()) == 2


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    for workers in (1, 2):
        control(tmp_path / str(workers), 3, workers=workers)
    assert load_demos(tmp_path / "1" / "episodes").hash == load_demos(tmp_path / "2" / "episodes").hash


@pytest.mark.slow
def test_demonstrations_end_where_the_robot_arrived(tmp_path: Path) -> None:
    found = control(tmp_path / "run", 2, seconds=4.0)
    whole, demos = load_demos(tmp_path / "run" / "episodes"), load_demos(tmp_path / "run" / "demos")
    assert found.success == len(demos) / 2 and found.return_worst <= found.return_mean
    for number, i in enumerate(map(int, demos.indices)):
        arrived = demos.episode(number).states
        assert PENDULUM.at_goal(arrived, whole.goals[0, :0])[-1]
        assert not PENDULUM.at_goal(arrived, whole.goals[0, :0])[-2]
        assert (whole.episode(i).states[: len(arrived)] == arrived).all()


def test_a_run_with_other_settings_is_refused(tmp_path: Path) -> None:
    control(tmp_path / "run", 1)
    with pytest.raises(PlanspaceError, match="samples was 16, now 8"):
        control(tmp_path / "run", 1, replace(CONFIG, samples=8))


def test_the_command_line_prints_json_and_films(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--cost", "reward", "--horizon-s", "0.8", "--samples", "16", "--no-film"]
    options += ["--episodes", "1", "--episode-s", "0.4"]
    code, out, err = call(capsys, "control", "pendulum", *options, "--json", "--out", tmp_path / "run")
    assert code == 0, err
    found = json.loads(out)
    wanted = {"success", "return_mean", "return_worst", "horizon_s", "samples", "real_time"}
    assert wanted <= found.keys() and found["samples"] == 16
    assert "<h2>Numbers</h2>" in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.slow
def test_the_report_shows_plans_beside_the_episodes(
    opengl: str, demo_folder: Path, embedding_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--episodes", "1", "--episode-s", "0.4", "--samples", "16", "--out", tmp_path / "run"]
    given = ["--embedding", embedding_folder, "--plans", demo_folder]
    code, out, err = call(capsys, "control", "cartpole-swingup", *given, *options)
    assert code == 0, err
    page = (tmp_path / "run" / "report.html").read_text()
    assert str(tmp_path / "run" / "report.html") in out
    assert page.count("data:image/gif;base64") == 1 and '"name":"plan"' in page
    assert '"name":"controlled episode"' in page and "http" not in page.split("</script>")[-1]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "which problem? One of acrobot"),
        (("pendulum",), "`--out DIR` is required"),
        (("pendulum", "--out", "x"), "the cost z needs an embedding"),
        (("pendulum", "--method", "cme"), "Did you mean 'cem'"),
        (("pendulum", "--out", "x", "--samples", "0"), "`samples` must be at least 1, got 0"),
    ],
)
def test_wrong_usage_is_one_line_and_writes_nothing(
    arguments: tuple[str, ...],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = call(capsys, "control", *arguments)
    assert code != 0 and says in err
    assert not list(tmp_path.iterdir())


def test_rows_that_a_repaired_log_lacks_are_made_again(tmp_path: Path) -> None:
    whole = control(tmp_path / "run", 3, seconds=0.1)
    log = tmp_path / "run" / "log.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    for left in (lines[:2], lines[:1] + lines[2:], [], [*lines[:2], lines[2][:9]]):
        log.write_text("".join(left))
        again = control(tmp_path / "run", 3, seconds=0.1)
        assert replace(again, real_time=0.0) == replace(whole, real_time=0.0)
        rows = [json.loads(line)["episode"] for line in log.read_text().splitlines()]
        assert sorted(rows) == [0, 1, 2]
        assert len(load_demos(tmp_path / "run" / "episodes")) == 3


def test_rows_are_not_doubled_where_a_repair_lost_more(tmp_path: Path) -> None:
    whole, run = control(tmp_path / "run", 5, seconds=0.1), tmp_path / "run"
    log = (run / "log.jsonl").read_text().splitlines(keepends=True)
    for name in ("episodes", "demos"):
        shutil.rmtree(run / name)
    control(run, 2, seconds=0.1)  # two episodes are left, and all rows but one
    (run / "log.jsonl").write_text("".join(log[:2] + log[3:]))
    assert replace(control(run, 5, seconds=0.1), real_time=0.0) == replace(whole, real_time=0.0)
    rows = [json.loads(line)["episode"] for line in (run / "log.jsonl").read_text().splitlines()]
    assert sorted(rows) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("seconds", [0.0, -1.0, 0.001, float("nan"), float("inf")])
def test_an_episode_lasts_a_control_step_or_more(seconds: float, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="episode_s.*at least a control step"):
        control(tmp_path / "run", 1, seconds=seconds)
    assert not (tmp_path / "run").exists()


def test_a_file_of_settings_decides_seed_and_length(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [
        "control",
        "pendulum-swingup",
        "--cost",
        "reward",
        "--samples",
        "8",
        "--episodes",
        "1",
        "--no-film",
    ]
    first, second = tmp_path / "first", tmp_path / "second"
    assert call(capsys, *given, "--seed", "7", "--episode-s", "0.2", "--out", first)[0] == 0
    assert call(capsys, *given, "--config", first / "config.json", "--out", second)[0] == 0
    configs = [json.loads((out / "config.json").read_text()) for out in (first, second)]
    assert configs[0] == configs[1] and configs[0]["seed"] == 7


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("seed: -1", "seed must be a whole number of at least 0, got -1"),
        ("episode_steps: 0", "episode_steps must be a whole number of at least 1, got 0"),
        ("plans: mine", "`plans` cannot be set in a file: use --plans DIR"),
        ("embedding: [a, b]", "`embedding` cannot be set in a file"),
    ],
)
def test_what_a_file_of_settings_cannot_hold_is_refused(
    line: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.yaml").write_text(line + "\n")
    given = ["control", "pendulum-swingup", "--cost", "reward", "--config", tmp_path / "a.yaml"]
    code, _, err = call(capsys, *given, "--out", tmp_path / "run")
    assert code == 2 and message in err and not (tmp_path / "run").exists()
