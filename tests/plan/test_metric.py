"""A metric decides which nodes a search extends, is recorded, and is checked."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.load import load_demos
from planspace.embed.embedding import Embedding
from planspace.embed.planning_metric import PlanningMetric
from planspace.errors import PlanspaceError, UsageError
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_demos, plan_into
from planspace.plan.metric import check_metric
from planspace.plan.pipeline import Pipeline
from planspace.plan.planners import PLANNERS
from planspace.plan.sst import SST
from planspace.plan.sst_search import SSTSearch
from planspace.tasks.problem_file import load_problem

from ..cli.calls import call

HANGING = np.array([0.0, np.pi, 0.0, 0.0])


def distance_of_carts(states: np.ndarray, goals: np.ndarray) -> np.ndarray:
    return np.abs(states[:, 0] - goals[:, 0])


def wrong_shape(states: np.ndarray, goals: np.ndarray) -> np.ndarray:
    return states - goals


def search(metric, greedy: float = 0.0) -> SSTSearch:
    problem = load_problem("cartpole-swingup")
    config = PlanConfig.for_problem(problem, greedy=greedy)
    pipeline = Pipeline(problem, replace(config, metric=metric))
    rng = np.random.default_rng(0)
    query = pipeline.query(HANGING, problem.draw_goal(pipeline.space, rng))
    return SSTSearch(config.planner, query, rng)  # pyright: ignore[reportArgumentType]


def test_a_quarter_of_the_extensions_start_near_the_goal_by_the_metric(monkeypatch) -> None:
    found = search(distance_of_carts)
    chosen = []
    select = SSTSearch._select

    def recorded(self: SSTSearch, tree, radius: float) -> np.ndarray:
        parents = select(self, tree, radius)
        chosen.append(np.abs(tree.states[parents, 0]))
        return parents

    monkeypatch.setattr(SSTSearch, "_select", recorded)
    assert found.solve().arrived
    last = chosen[-1]
    assert np.median(last[-128:]) < 0.2 * np.median(last[:-128])


def test_manifests_record_the_metric(tmp_path: Path, embedding: Embedding) -> None:
    problem = load_problem("cartpole-swingup")
    config = PlanConfig.for_problem(problem, restarts=1)
    by_z = replace(config, metric=embedding.distance)
    plan_into(problem, tmp_path / "z", num=1, seed=0, config=by_z, workers=1)
    recorded = json.loads((tmp_path / "z" / "manifest.json").read_text())["settings"]["config"]["metric"]
    assert recorded == {"name": "planspace.embed.embedding:Embedding.distance", "hash": embedding.hash}
    with pytest.raises(PlanspaceError, match="metric"):
        plan_into(problem, tmp_path / "z", num=2, seed=0, config=config)
    plan_into(problem, tmp_path / "z", num=2, seed=0, config=by_z, workers=1)
    own = plan_demos(problem, 2, config=config, metric=distance_of_carts, workers=0, verbose=False)
    assert own.hash != load_demos(tmp_path / "z").hash


def test_metrics_that_cannot_be_used_are_refused() -> None:
    with pytest.raises(UsageError, match="a function of two arrays of states, got 3"):
        check_metric(3, SST())
    with pytest.raises(UsageError, match="ompl-rrt does not use a metric; sst does"):
        PlanConfig(PLANNERS["ompl-rrt"], metric=distance_of_carts)
    with pytest.raises(UsageError, match=re.escape("one finite number for each of 1 states, got")):
        search(wrong_shape).solve()


def test_the_command_line_plans_with_an_embedding(
    tmp_path: Path, embedding_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ("plan", "cartpole-swingup", "--num", 1, "--restarts", 1, "--metric", embedding_folder)
    code, out, _ = call(capsys, *command, "--out", tmp_path / "a")
    assert code == 0 and "1 demonstration in" in out
    manifest = json.loads((tmp_path / "a" / "manifest.json").read_text())
    assert manifest["settings"]["config"]["metric"]["name"] == PlanningMetric.name
    command = ("plan", "acrobot", "--num", 1, "--metric", embedding_folder)
    code, _, err = call(capsys, *command, "--out", tmp_path / "b")
    assert code == 2 and "'slider' is missing" in err and not (tmp_path / "b").exists()
