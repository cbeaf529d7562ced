import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from planspace.cli import main
from planspace.errors import PartialResult, PlanspaceError
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.study import quickstart as module
from planspace.study.quickstart import BUDGETS, rebuild, run
from planspace.study.run_summary import (
    GEOMETRY_ROWS,
    ArmReturns,
    DemosSummary,
    GeometrySummary,
    RunSummary,
    as_json,
    as_text,
)
from planspace.tasks.problem_file import load_problem

from ..conftest import QUICK_FIT, QUICK_PLANNER
from ..tasks.test_problem_task import CRANE, RANDOM
from ..tasks.test_problem_task import write as write_crane

TINY = replace(
    BUDGETS["smoke"],
    demos=12,
    planner=QUICK_PLANNER,
    fit=replace(QUICK_FIT, steps=100),
    embedding_seeds=2,
    seeds=2,
    steps=8000,
)

STILL = RANDOM.replace("-0.1, 0, 0], high: [1, 0.1", "0, 0, 0], high: [1, 0")
"""Random goals in which the load can hang at rest."""


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BUDGETS, "smoke", TINY)


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_run_does_every_stage_and_repeats_no_finished_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    summary = run("cartpole-swingup", "smoke", out, 0)
    assert list(summary.arms) == ["raw", "raw + sin/cos", "raw + sin/cos + z"]
    assert summary.demos.fraction_near_goal >= 0.95
    assert json.loads((out / "summary.json").read_text()) == as_json(summary)
    table = as_text(summary)
    assert "raw + sin/cos + z" in table and "midpoint error" in table

    stamps = {p: p.stat().st_mtime_ns for p in out.rglob("*") if p.is_file()}
    assert run("cartpole-swingup", "smoke", out, 0) == summary
    redone = {p.name for p, stamp in stamps.items() if p.stat().st_mtime_ns != stamp}
    assert redone <= {"summary.json", "report.html"} | {p.name for p in (out / "figures").iterdir()}

    (out / "report.html").unlink()
    assert rebuild(out) == summary
    assert (out / "report.html").exists()
    with pytest.raises(PlanspaceError, match="other settings: seed was 0, now 1"):
        run("cartpole-swingup", "smoke", out, 1)

    file = out / "embedding" / "embedding.json"
    whole, text = file.read_bytes(), read_sealed(file)
    del text["about"]["metrics"]
    write_sealed(file, text)
    with pytest.raises(PlanspaceError, match=f"{file} was altered or damaged: .*'metrics'"):
        rebuild(out)
    file.write_bytes(whole)

    # after an interrupt in the last arm, only that arm has work left
    (out / "train" / "trig-z" / "history.safetensors").unlink()
    trained = []
    train = module.train_policies

    def spy(*args: Any, out: Path, **options: Any) -> Any:
        trained.append(out.name)
        return train(*args, out=out, **options)

    monkeypatch.setattr(module, "train_policies", spy)
    assert run("cartpole-swingup", "smoke", out, 0) == summary
    assert trained == ["raw", "trig", "trig-z"]


@pytest.mark.nightly
@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("task", ["cartpole", "reacher-trig", "reacher-raw"])
def test_every_task_runs(task: str, tmp_path: Path) -> None:
    summary = run(task, "smoke", tmp_path / "run", 0)
    assert len(summary.arms) == (2 if task == "reacher-trig" else 3)
    assert (tmp_path / "run" / "report.html").stat().st_size > 1e6


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize(
    "base",
    [
        pytest.param(CRANE, id="one goal"),
        pytest.param(STILL, id="random goals", marks=pytest.mark.nightly),
    ],
)
def test_a_problem_file_runs_like_a_shipped_task(
    base: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    file, out = write_crane(tmp_path, base), Path("runs/crane-smoke")
    assert main(["run", file.name, "--budget", "smoke"]) == 0
    shown = capsys.readouterr().out
    assert "crane, budget smoke, seed 0" in shown and "raw + sin/cos + z" in shown
    file.write_text(file.read_text() + "task: {horizon_s: 2}\n")
    assert main(["run", file.name, "--budget", "smoke"]) == 1
    assert "was made with other settings: task_sha256 was" in capsys.readouterr().err
    for path in tmp_path.glob("crane.*"):
        path.unlink()  # the run holds its task
    assert main(["play", str(out), "--arm", "trig-z", "--episodes", "2"]) == 0
    assert "2 episodes of crane" in capsys.readouterr().out
    assert main(["report", str(out)]) == 0
    assert "crane, budget smoke, seed 0" in capsys.readouterr().out
    stored = out / "train" / "raw" / "task" / "crane.yaml"
    stored.write_text(stored.read_text().replace("bonus: 1.0", "bonus: 2.0"))
    assert main(["play", str(out), "--arm", "raw"]) == 2
    assert "was trained on another version of the task 'crane'" in capsys.readouterr().err


@pytest.mark.nightly
@pytest.mark.usefixtures("tiny")
def test_a_run_goes_on_without_plans_that_were_not_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = module.plan_into

    def with_failures(*args: Any, **options: Any) -> None:
        plan(*args, **options)
        raise PartialResult("1 of 12 plans was not found.")

    monkeypatch.setattr(module, "plan_into", with_failures)
    assert main(["run", "cartpole", "--budget", "smoke", "--out", str(tmp_path / "run")]) == 3
    shown = capsys.readouterr()
    assert "return of TRPO" in shown.out and "1 of 12 plans was not found." in shown.err
    monkeypatch.setattr(module, "load_demos", lambda path: load_problem("nothing"))
    with pytest.raises(PartialResult, match="1 of 12 plans"):
        run("cartpole", "smoke", tmp_path / "run", 0)


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_report_is_self_contained_and_escapes_names(tmp_path: Path) -> None:
    from planspace.demos.load import load_demos
    from planspace.embed.saved_embedding import load_embedding
    from planspace.storage.arrays import read_arrays
    from planspace.study.quickstart_report import write_report

    out = tmp_path / "run"
    summary = replace(run("cartpole-swingup", "smoke", out, 0), task="<script>alert(1)</script>")
    demos, embedding = load_demos(out / "demos"), load_embedding(out / "embedding")
    history = read_arrays(out / "train" / "raw" / "history.safetensors")
    html = write_report(out, summary, demos, embedding, {"raw": history}).read_text()
    assert "&lt;script&gt;alert(1)" in html and "<script>alert(1)" not in html
    own = html[: html.index("<script>")] + html[html.index("</script>") :]  # Plotly's code contains many URLs
    assert "http" not in own.replace("http-equiv", "")
    assert "default-src 'none'" in own


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
SUMMARY = RunSummary(
    task="cartpole",
    budget="smoke",
    seed=0,
    version="1.0",
    demos=DemosSummary(
        count=3, fraction_near_goal=1.0, near_goal=0.5, median_end_distance=0.1, median_duration_s=1.0
    ),
    geometry=GeometrySummary(embedding_seed=2, embedding={**METRICS, "num_demos": 1}, raw_state=METRICS),
    arms={"raw": ArmReturns(steps=8000, seeds=2, mean=2.0, worst=1.0, best=3.0, standard_deviation=1.4)},
    diverged=("raw: seed 1",),
)


def test_an_undefined_metric_is_shown_as_a_dash() -> None:
    assert "straightness                 -           -   1 is a straight line" in as_text(SUMMARY)


def test_the_keys_of_the_summary_file_do_not_change() -> None:
    found = as_json(SUMMARY)
    assert " ".join(found) == "task budget seed version demos geometry arms diverged"
    demos_keys = "count share_near_goal near_goal median_end_distance median_duration_s"
    assert " ".join(found["demos"]) == demos_keys
    assert " ".join(found["geometry"]) == "split embedding_seed embedding raw_state"
    assert " ".join(found["arms"]["raw"]) == "steps seeds mean worst best deviation"
    assert json.loads(json.dumps(found)) == found
