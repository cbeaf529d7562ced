import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from planspace.errors import PlanspaceError
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.study import quickstart as module
from planspace.study.quickstart import BUDGETS, closing_table, rebuild, run

from ..conftest import QUICK_FIT, QUICK_PLANNER

TINY = replace(
    BUDGETS["smoke"],
    demos=12,
    planner=QUICK_PLANNER,
    fit=replace(QUICK_FIT, steps=100),
    embedding_seeds=2,
    seeds=2,
    steps=8000,
)


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BUDGETS, "smoke", TINY)


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_goes_through_every_stage_and_does_no_finished_work_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    summary = run("cartpole-swingup", "smoke", out, 0)
    assert list(summary["arms"]) == ["raw", "raw + sin/cos", "raw + sin/cos + z"]
    assert summary["demos"]["share_near_goal"] >= 0.95
    assert json.loads((out / "summary.json").read_text()) == summary
    table = closing_table(summary)
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

    # an interrupt in the last arm costs that arm's last steps, nothing else
    (out / "train" / "trig-z" / "history.safetensors").unlink()
    trained = []
    train = module.train_policies

    def spy(*args: Any, out: Path, **options: Any) -> Any:
        trained.append(out.name)
        return train(*args, out=out, **options)

    monkeypatch.setattr(module, "train_policies", spy)
    assert run("cartpole-swingup", "smoke", out, 0) == summary
    assert trained == ["raw", "trig", "trig-z"]


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("task", ["cartpole", "reacher-trig", "reacher-raw"])
def test_every_task_runs(task: str, tmp_path: Path) -> None:
    summary = run(task, "smoke", tmp_path / "run", 0)
    assert len(summary["arms"]) == (2 if task == "reacher-trig" else 3)
    assert (tmp_path / "run" / "report.html").stat().st_size > 1e6


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_the_report_needs_nothing_beside_it_and_names_stay_text(tmp_path: Path) -> None:
    from planspace.demos.load import load_demos
    from planspace.embed.saved_embedding import load_embedding
    from planspace.storage.arrays import read_arrays
    from planspace.study.quickstart_report import write_report

    out = tmp_path / "run"
    summary = run("cartpole-swingup", "smoke", out, 0)
    summary["task"] = "<script>alert(1)</script>"
    demos, embedding = load_demos(out / "demos"), load_embedding(out / "embedding")
    history = read_arrays(out / "train" / "raw" / "history.safetensors")
    html = write_report(out, summary, demos, embedding, {"raw": history}).read_text()
    assert "&lt;script&gt;alert(1)" in html and "<script>alert(1)" not in html
    own = html[: html.index("<script>")] + html[html.index("</script>") :]  # Plotly's code names many places
    assert "http" not in own.replace("http-equiv", "")
    assert "default-src 'none'" in own


def test_a_folder_of_another_kind_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="cannot read"):
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
def test_settings_that_are_not_whole(change: dict[str, object], missing: str, tmp_path: Path) -> None:
    whole = {"command": "run", "task": "cartpole", "budget": "smoke", "seed": 0}
    (tmp_path / "config.json").write_text(json.dumps(whole | change))
    with pytest.raises(PlanspaceError, match=f"config.json does not say the run's {missing}; restore it"):
        rebuild(tmp_path)


def test_a_metric_that_is_not_defined_is_shown_as_a_dash() -> None:
    rows = dict.fromkeys((key for key, _, _ in module.GEOMETRY_ROWS), None)
    demos = {"count": 3, "share_near_goal": 1.0, "near_goal": 0.5}
    demos |= {"median_end_distance": 0.1, "median_duration_s": 1.0}
    geometry = {"embedding": {**rows, "num_demos": 1}, "raw_state": rows}
    summary = {"task": "cartpole", "budget": "smoke", "seed": 0, "demos": demos, "geometry": geometry}
    assert "straightness                 -           -   1 is a straight line" in module.closing_table(
        {**summary, "arms": {}}
    )
