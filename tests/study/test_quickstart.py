import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.cli import main
from planspace.demos.load import load_demos
from planspace.errors import PartialResult, PlanspaceError
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.study import quickstart as module
from planspace.study import quickstart_report, run_control
from planspace.study.budgets import BUDGETS, ControlBudget
from planspace.study.quickstart import rebuild, run
from planspace.study.run_control import CONTROL, ControlResults, Reached, controlled_episodes
from planspace.study.run_summary import (
    GEOMETRY_ROWS,
    ArmReturns,
    DemosSummary,
    GeometrySummary,
    RunSummary,
    as_json,
)
from planspace.study.run_text import as_text, headline
from planspace.tasks.catalog import find_task
from planspace.tasks.problem_file import load_problem
from planspace.tasks.stored_task import save_task
from planspace.tasks.task import Task

from ..conftest import QUICK_FIT, QUICK_PLANNER
from ..tasks.test_problem_task import CRANE, RANDOM
from ..tasks.test_problem_task import write as write_crane

SWING_UP = "cartpole-swingup"
TINY = replace(
    BUDGETS["smoke"],
    demos=12,
    planner=QUICK_PLANNER,
    fit=QUICK_FIT,
    embedding_seeds=2,
    control=ControlBudget(starts=2, samples=8, horizons=(0.32,), horizon_starts=1),
    seeds=2,
    steps=4000,
)
STILL = RANDOM.replace("-0.1, 0, 0], high: [1, 0.1", "0, 0, 0], high: [1, 0")
"""Random goals in which the load can hang at rest."""


def no_film(*_: Any) -> None:
    raise PlanspaceError("the robot cannot be drawn: no OpenGL backend works here.")


@pytest.fixture(scope="module", autouse=True)
def tiny() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(BUDGETS, "smoke", TINY)
        patch.setattr(
            run_control, "control_into", partial(run_control.control_into, workers=0, episode_s=0.2)
        )
        patch.setattr(quickstart_report, "render_side_by_side", no_film)
        yield


@pytest.fixture(scope="module")
def finished_run(demo_folder: Path, embedding_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the swing-up without policies, with plans and embedding of the session."""
    out = tmp_path_factory.mktemp("quickstart") / "run"
    with pytest.MonkeyPatch.context() as patch:
        plan = module.plan_into

        def copied(problem: Any, folder: Path, **options: Any) -> None:
            shutil.copytree(demo_folder, folder)
            shutil.copytree(embedding_folder, folder.parent / "embedding")
            plan(problem, folder, **options)  # nothing is left to plan

        patch.setattr(module, "plan_into", copied)
        run(SWING_UP, "smoke", out, 0)
    return out


@pytest.fixture
def folder(finished_run: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return Path(shutil.copytree(finished_run, tmp_path / "run"))


def stamps(folder: Path) -> dict[Path, int]:
    return {p: p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}


@pytest.mark.slow
def test_a_finished_run_repeats_no_work_and_is_rebuilt(folder: Path) -> None:
    before = stamps(folder)
    summary = run(SWING_UP, "smoke", folder, 0)
    redone = {p.name for p, stamp in before.items() if p.stat().st_mtime_ns != stamp}
    assert redone <= {"summary.json", "report.html"} | {p.name for p in (folder / "figures").iterdir()}
    written = json.loads((folder / "summary.json").read_text())
    assert written == as_json(summary) and next(iter(written)) == "control" and written["arms"] == {}
    found = summary.control.reached
    assert found is not None and (found.starts, found.horizon_s) == (2, 0.32)
    assert [cost for cost, _ in summary.control.by_horizon] == ["z", "raw", "reward"]
    (folder / "report.html").unlink()
    assert rebuild(folder) == summary and (folder / "report.html").exists()
    with pytest.raises(PlanspaceError, match="other settings: seed was 0, now 1"):
        run(SWING_UP, "smoke", folder, 1)


@pytest.mark.slow
def test_an_interrupted_control_stage_gives_the_same_content(folder: Path) -> None:
    whole, summary = controlled_episodes(folder, "z", 0.32), (folder / "summary.json").read_bytes()
    shutil.rmtree(folder / CONTROL / "z-0.32s")
    (folder / "summary.json").unlink()
    run(SWING_UP, "smoke", folder, 0)
    again = controlled_episodes(folder, "z", 0.32)
    np.testing.assert_array_equal(again.states, whole.states)
    assert (folder / "summary.json").read_bytes() == summary
    plain = folder / CONTROL / "raw-0.32s" / "episodes"
    np.testing.assert_array_equal(load_demos(plain).episode(0).states[0], whole.episode(0).states[0])


@pytest.mark.slow
def test_a_damaged_embedding_is_named(folder: Path) -> None:
    file = folder / "embedding" / "embedding.json"
    text = read_sealed(file)
    del text["about"]["metrics"]
    write_sealed(file, text)
    with pytest.raises(PlanspaceError, match=f"{file} was altered or damaged: .*'metrics'"):
        rebuild(folder)


@pytest.mark.nightly
def test_train_continues_a_finished_run(folder: Path) -> None:
    before = stamps(folder)
    summary = run(SWING_UP, "smoke", folder, 0, train=True)
    assert list(summary.arms) == ["raw", "raw + sin/cos", "raw + sin/cos + z"]
    kept = [p for p in before if p.relative_to(folder).parts[0] in ("demos", "embedding", CONTROL)]
    assert kept and all(p.stat().st_mtime_ns == before[p] for p in kept if p.name != ".writing-lock")
    shown = as_text(summary)
    assert "raw + sin/cos + z" in shown and "2 seeds are too few to compare" in shown
    assert "<h2>Learning curves</h2>" in (folder / "report.html").read_text()
    (folder / "train" / "trig-z" / "history.safetensors").unlink()  # an interrupt in the last arm
    others = stamps(folder / "train" / "raw")
    assert run(SWING_UP, "smoke", folder, 0) == summary  # policies of the folder stay in its report
    assert all(p.stat().st_mtime_ns == s for p, s in others.items() if p.name != ".writing-lock")


@pytest.mark.nightly
@pytest.mark.parametrize("task", ["cartpole", "reacher-trig", "reacher-raw", "arm", "hopper-stand"])
def test_every_task_runs(task: str, tmp_path: Path) -> None:
    summary = run(task, "smoke", tmp_path / "run", 0)
    assert summary.control.reached is not None
    assert (tmp_path / "run" / "report.html").stat().st_size > 1e6


@pytest.mark.nightly
@pytest.mark.parametrize("base", [pytest.param(CRANE, id="one goal"), pytest.param(STILL, id="random goals")])
def test_a_problem_file_runs_like_a_shipped_task(
    base: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(BUDGETS, "smoke", replace(TINY, demos=6, embedding_seeds=1))
    file, out = write_crane(tmp_path, base), Path("runs/crane-smoke")
    assert main(["run", file.name, "--budget", "smoke"]) == 0
    shown = capsys.readouterr().out
    assert "crane, budget smoke, seed 0" in shown and "raw + sin/cos + z" not in shown
    assert "The reward of this task is computed from its goal, so control by reward is left out." in shown
    assert shown.splitlines()[-1].startswith("Looking 0.32 s ahead, control by distance in z succeeds from")
    file.write_text(file.read_text() + "task: {horizon_s: 2}\n")
    assert main(["run", file.name, "--budget", "smoke"]) == 1
    assert "was made with other settings: task_sha256 was" in capsys.readouterr().err
    for path in tmp_path.glob("crane.*"):
        path.unlink()  # the run holds its task
    assert main(["report", str(out)]) == 0
    assert "crane, budget smoke, seed 0" in capsys.readouterr().out


@pytest.mark.nightly
def test_policies_of_a_problem_file_are_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    file, out = write_crane(tmp_path, CRANE), Path("runs/crane-smoke")
    assert main(["run", file.name, "--budget", "smoke", "--train"]) == 0
    assert main(["play", str(out), "--arm", "trig-z", "--episodes", "2"]) == 0
    assert "2 episodes of crane" in capsys.readouterr().out
    stored = out / "train" / "raw" / "task" / "crane.yaml"
    stored.write_text(stored.read_text().replace("bonus: 1.0", "bonus: 2.0"))
    assert main(["play", str(out), "--arm", "raw"]) == 2
    assert "was trained on another version of the task 'crane'" in capsys.readouterr().err


@pytest.mark.nightly
def test_a_run_goes_on_without_plans_that_were_not_found(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def with_failures(*_: Any, **__: Any) -> None:
        raise PartialResult("1 of 12 plans was not found.")

    monkeypatch.setattr(module, "plan_into", with_failures)
    assert main(["run", SWING_UP, "--budget", "smoke", "--out", str(folder)]) == 3
    shown = capsys.readouterr()
    assert "distance in z succeeds" in shown.out and "1 of 12 plans was not found." in shown.err
    monkeypatch.setattr(module, "load_demos", lambda path: load_problem("nothing"))
    with pytest.raises(PartialResult, match="1 of 12 plans"):
        run(SWING_UP, "smoke", folder, 0)


def test_the_report_names_what_the_command_line_was_given(tmp_path: Path) -> None:
    own = find_task(write_crane(tmp_path, CRANE))
    assert isinstance(own, Task)
    save_task(own, tmp_path / "run")
    assert quickstart_report.given_as(own, tmp_path / "run") == "crane.yaml"
    assert quickstart_report.given_as(find_task(SWING_UP), tmp_path / "other") == SWING_UP


@pytest.mark.slow
def test_report_is_self_contained_and_escapes_names(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = quickstart_report.write_report

    def renamed(out: Path, summary: RunSummary, *others: Any) -> Path:
        return write(out, replace(summary, task="<script>alert(1)</script>"), *others)

    monkeypatch.setattr(module, "write_report", renamed)
    run(SWING_UP, "smoke", folder, 0)
    html = (folder / "report.html").read_text()
    assert "&lt;script&gt;alert(1)" in html and "<script>alert(1)" not in html
    own = html[: html.index("<script>")] + html[html.index("</script>") :]  # Plotly's code contains many URLs
    assert "http" not in own.replace("http-equiv", "")
    assert "default-src 'none'" in own
    order = ["Looking 0.32 s ahead", "The film is left out", "Paths in z", "Distance to the goal"]
    order += ["Success by horizon", "<h2>Geometry", "<h2>Demonstrations"]
    assert sorted(order, key=own.index) == order


@pytest.mark.slow
def test_the_report_opens_with_a_film(folder: Path, opengl: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from planspace.demos.render import FilmConfig, render_side_by_side

    monkeypatch.setattr(quickstart_report, "render_side_by_side", render_side_by_side)
    monkeypatch.setattr(quickstart_report, "FILMED", FilmConfig(episodes=1, fps=1, width=32, height=32))
    run(SWING_UP, "smoke", folder, 0)
    html = (folder / "report.html").read_text()
    assert html.index("data:image/gif") < html.index("Paths in z") and "film is left out" not in html


def test_rebuild_rejects_a_folder_of_another_kind(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="none does not exist; give the folder of a run"):
        rebuild(tmp_path / "none")
    with pytest.raises(PlanspaceError, match="is not the folder of a `planspace run`"):
        rebuild(tmp_path)
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(PlanspaceError, match="is not the folder of a `planspace run`"):
        rebuild(tmp_path)


@pytest.mark.parametrize(
    ("change", "missing"),
    [
        ({"task": None}, "task"),
        ({"task": ["cartpole"]}, "task"),
        ({"budget": 3}, "budget"),
        ({"seed": "0"}, "seed"),
    ],
)
def test_rebuild_rejects_an_incomplete_config(
    change: dict[str, object], missing: str, tmp_path: Path
) -> None:
    whole = {"command": "run", "task": "cartpole", "budget": "smoke", "seed": 0}
    (tmp_path / "config.json").write_text(json.dumps(whole | change))
    with pytest.raises(PlanspaceError, match=f"config.json has no valid {missing}; restore the file"):
        rebuild(tmp_path)


METRICS = dict.fromkeys((key for key, _, _ in GEOMETRY_ROWS), None)
REACHED = Reached(horizon_s=0.32, starts=50, z=49, raw=3, difference=0.92, interval=(0.8, 0.97))
SUMMARY = RunSummary(
    control=ControlResults(REACHED, (0.16, 0.32), 4, (("z", (3, 4)), ("raw", (0, 1))), ("Left out.",)),
    task="cartpole",
    budget="smoke",
    seed=0,
    version="1.0",
    demos=DemosSummary(
        count=3,
        at_goal=3,
        fraction_near_goal=1.0,
        near_goal=0.5,
        median_end_distance=0.1,
        median_duration_s=1.0,
    ),
    geometry=GeometrySummary(embedding_seed=2, embedding={**METRICS, "num_demos": 1}, raw_state=METRICS),
    arms={"raw": ArmReturns(steps=8000, seeds=2, mean=2.0, worst=1.0, best=3.0, standard_deviation=1.4)},
    diverged=("raw: seed 1",),
)


def test_an_undefined_metric_is_shown_as_a_dash() -> None:
    assert "straightness                 -           -   1 is a straight line" in as_text(SUMMARY)


def test_the_headline_says_what_each_reached() -> None:
    assert headline(SUMMARY.control) == (
        "Looking 0.32 s ahead, control by distance in z succeeds from 49 of 50 starts and by raw distance "
        "from 3: +92 percentage points (95 % interval +80 to +97)."
    )
    assert headline(ControlResults()) == ""
    assert "  distance in z                     75%     100%" in as_text(SUMMARY)


def test_the_keys_of_the_summary_file_do_not_change() -> None:
    found = as_json(SUMMARY)
    assert " ".join(found) == "control task budget seed version demos geometry arms diverged verdicts"
    demos_keys = "count at_goal share_near_goal near_goal median_end_distance median_duration_s"
    assert " ".join(found["demos"]) == demos_keys
    assert " ".join(found["geometry"]) == "split embedding_seed embedding raw_state"
    control_keys = "horizon_s starts z raw difference interval"
    assert " ".join(found["control"]) == "success by_horizon notes"
    assert " ".join(found["control"]["success"]) == control_keys
    assert " ".join(found["arms"]["raw"]) == "steps seeds mean worst best deviation"
    assert json.loads(json.dumps(found)) == found
