import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.errors import PartialResult, PlanspaceError, UsageError
from planspace.plan.config import PlanConfig, PolishConfig
from planspace.plan.demonstrations import TREE_SETTINGS, plan_into, upgrade_settings
from planspace.plan.pipeline import Pipeline
from planspace.plan.planner import Failure
from planspace.plan.planners import PLANNERS
from planspace.plan.sst import SST
from planspace.seams import plain_settings
from planspace.tasks.problem import Box
from planspace.tasks.problem_file import load_problem

from ..conftest import QUICK_PLANNER

UNPOLISHED = PlanConfig(restarts=1, polish=PolishConfig(max_iterations=0))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "config"),
    [("cartpole", UNPOLISHED), pytest.param("cartpole-swingup", QUICK_PLANNER, marks=pytest.mark.nightly)],
)
def test_interrupted_planning_ends_like_uninterrupted_planning(
    name: str, config: PlanConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, planned = load_problem(name), []
    plan, out = Pipeline.plan, tmp_path / "interrupted"
    plan_into(problem, tmp_path / "alone", num=12, seed=0, config=config, workers=0)

    def counted(*args: object):
        planned.append(args[-1])
        if len(planned) == 12:
            raise KeyboardInterrupt
        return plan(*args)  # pyright: ignore

    monkeypatch.setattr(Pipeline, "plan", counted)
    with pytest.raises(KeyboardInterrupt):
        plan_into(problem, out, num=12, seed=0, config=config, workers=0)
    assert len(load_demos(out)) == 11  # a full shard, and a plan that was finished before the interrupt
    plan_into(problem, out, num=12, seed=0, config=config, workers=0)
    assert planned == [*range(12), 11]  # only the interrupted plan is repeated
    assert load_demos(out).hash == load_demos(tmp_path / "alone").hash


@pytest.mark.slow
def test_plans_do_not_depend_on_the_number_of_workers(demos: Demos, tmp_path: Path) -> None:
    plan_into(load_problem("cartpole-swingup"), tmp_path, num=12, seed=0, config=QUICK_PLANNER, workers=3)
    assert load_demos(tmp_path).hash == demos.hash  # with one worker per core


def test_a_finished_dataset_stays_as_it_is_and_other_settings_are_refused(demo_folder: Path) -> None:
    problem = load_problem("cartpole-swingup")
    before = {p.name: p.read_bytes() for p in demo_folder.iterdir()}
    plan_into(problem, demo_folder, num=12, seed=0, config=QUICK_PLANNER)
    assert {p.name: p.read_bytes() for p in demo_folder.iterdir()} == before
    with pytest.raises(PlanspaceError, match="other settings: seed was 0, now 7."):
        plan_into(problem, demo_folder, num=12, seed=7, config=QUICK_PLANNER)


def test_failed_plans_are_counted_and_the_others_are_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, failure = Pipeline.plan, Failure("no path found within the budget", 0.25)
    monkeypatch.setattr(Pipeline, "plan", lambda *args: failure if args[-1] == 1 else plan(*args))
    problem = load_problem("cartpole")
    with pytest.raises(
        PartialResult, match="1 of 3 plans found no way to the goal .*came within 0.25"
    ) as raised:
        plan_into(problem, tmp_path, num=3, seed=0, config=QUICK_PLANNER, workers=0)
    assert raised.value.exit_code == 3
    assert load_demos(tmp_path).indices.tolist() == [0, 2]
    logged = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    expected = {"plan": 1, "nearest": 0.25, "reason": "no path found within the budget"}
    assert logged[-1]["failures"] == [expected]
    with open(tmp_path / "log.jsonl", "ab") as log:
        log.write(b'{"failures": 1}\n')
    with pytest.raises(PlanspaceError, match="log.jsonl was altered or damaged.*`planspace repair"):
        plan_into(problem, tmp_path, num=3, seed=0, config=QUICK_PLANNER, workers=0)


def test_planning_for_an_unreachable_goal_stops_and_reports_the_nearest_distance(tmp_path: Path) -> None:
    problem = load_problem("cartpole-swingup")
    # at rest with a horizontal pole: no control can hold it there
    level = (0.0, np.pi / 2, 0.0, 0.0)
    hanging = replace(problem, goal=Box(level, level), start=Box((0.0, 3.1, 0.0, 0.0), (0.0, 3.1, 0.0, 0.0)))
    hopeless = PlanConfig(
        SST(extensions=64, min_rounds=1, max_rounds=2),
        restarts=1,
        polish=PolishConfig(max_iterations=5, repairs=0),
    )
    unheld = pytest.warns(UserWarning, match="'hinge' has moved by 1.94. If no plan is found, give a goal at")
    with unheld, pytest.raises(PartialResult, match="1 of 1 plans .* The nearest came within [0-9.]+ of it"):
        plan_into(hanging, tmp_path, num=1, seed=0, config=hopeless, workers=0)
    with pytest.raises(
        PartialResult, match="1 of 1 plans .* The nearest came within"
    ):  # a second call reports it again
        plan_into(hanging, tmp_path, num=1, seed=0, config=hopeless, workers=0)


def test_only_the_changed_setting_is_named(tmp_path: Path) -> None:
    problem = load_problem("cartpole")
    plan_into(problem, tmp_path, num=1, seed=0, config=QUICK_PLANNER, workers=0)
    other = replace(QUICK_PLANNER, planner=SST(extensions=128))
    with pytest.raises(
        PlanspaceError, match=r"settings: config.planner.extensions was 256, now 128\. Choose another --out"
    ):
        plan_into(problem, tmp_path, num=1, seed=0, config=other, workers=0)


def test_a_predicate_without_a_name_is_refused(tmp_path: Path) -> None:
    problem = replace(load_problem("cartpole"), predicate=lambda x: np.ones(len(x), dtype=bool))
    with pytest.raises(UsageError, match="must be a function that its module has by name, not a lambda"):
        plan_into(problem, tmp_path / "demos", num=1, seed=0)
    assert not (tmp_path / "demos").exists()


def test_settings_of_version_0_1_0_are_read_under_today_s_names() -> None:
    """Its manifests contain the settings of all planners, also of those that were not used."""
    golden = Path(__file__).parents[1] / "golden" / "2026-11" / "demos" / "manifest.json"
    saved = json.loads(golden.read_text())["settings"]
    config = PlanConfig(restarts=1, polish=PolishConfig(max_iterations=10))
    assert upgrade_settings(saved, 0.02)["config"] == without_trees(config)  # pyright: ignore
    ompl = saved | {"planner": "ompl-rrt", "config": saved["config"] | {"restarts": 2}}
    config = replace(config, planner=PLANNERS["ompl-rrt"])
    assert upgrade_settings(ompl, 0.02)["config"] == without_trees(config)  # pyright: ignore
    for malformed in ({}, {"planner": {}, "config": {}}, {"planner": "sst", "config": {"sst": 1}}):
        assert upgrade_settings(malformed, 0.02) == malformed  # pyright: ignore


def without_trees(config: PlanConfig) -> dict[str, object]:
    """What a manifest records of settings that keep no search trees."""
    return {name: value for name, value in plain_settings(config).items() if name not in TREE_SETTINGS}


def test_settings_that_an_earlier_version_did_not_have_get_their_defaults() -> None:
    config = PlanConfig(SST(extensions=256), restarts=3)
    saved = {"planner": "sst", "config": plain_settings(config)}
    del saved["config"]["planner"]["greedy"], saved["config"]["polish"]["shortcut_rounds"]  # pyright: ignore
    assert upgrade_settings(saved, 0.02)["config"] == plain_settings(config)  # pyright: ignore
