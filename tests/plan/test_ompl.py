import importlib.metadata
import importlib.util
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.demos.load import load_demos
from planspace.errors import PartialResult, PlanspaceError, UsageError
from planspace.physics.replay import replay
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.plan.ompl import process
from planspace.plan.ompl.planners import CONTROL_ALGORITHMS, GEOMETRIC_ALGORITHMS, OMPL
from planspace.plan.pipeline import Pipeline
from planspace.plan.planner import Plan
from planspace.tasks.problem import Box, Problem
from planspace.tasks.problem_file import load_problem

needs_ompl = pytest.mark.skipif(importlib.util.find_spec("ompl") is None, reason="needs the extra ompl")


def with_slow(algorithms: tuple[str, ...], quick: str) -> list[Any]:
    """All algorithms; all but one are marked slow."""
    return [a if a == quick else pytest.param(a, marks=pytest.mark.slow) for a in algorithms]


@pytest.mark.ompl
@needs_ompl
@pytest.mark.parametrize("algorithm", with_slow(CONTROL_ALGORITHMS, "RRT"))
def test_every_control_planner_finds_an_easy_path(algorithm: str) -> None:
    """A pendulum that starts near the top, with a large tolerance of 0.4, in a fixed number of iterations."""
    problem = replace(load_problem("pendulum"), tolerance=0.4)
    planner = OMPL(algorithm, iterations=2000)
    pipeline, start = Pipeline(problem, PlanConfig(planner)), np.array([0.25, 0.6])
    goal = problem.draw_goal(pipeline.space, np.random.default_rng(0))
    found = planner.plan(pipeline.query(start, goal), np.random.default_rng(0))
    assert isinstance(found, Plan), found
    times = np.arange(len(found.controls) + 1) * pipeline.model.opt.timestep
    states = replay(pipeline.model, pipeline.space, start, found.controls, times)
    assert goal.reached(states[-1:]).all()


@pytest.mark.ompl
@needs_ompl
def test_a_path_with_activations() -> None:
    model = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body>
      <joint name="x" type="slide" axis="1 0 0" range="-1 1" damping="1"/><geom size="0.1" mass="1"/></body>
      </worldbody><actuator><general joint="x" dyntype="filter" dynprm="0.1" gainprm="5" ctrlrange="-1 1"/>
      </actuator></mujoco>"""
    region = Box((0.5, 0.0), (0.5, 0.0))
    problem = Problem("sled", model, ("x",), Box((0.0, 0.0), (0.0, 0.0)), region, 0.3, sample_velocity=(2.0,))
    planner = OMPL("RRT", seconds=3.0)
    pipeline = Pipeline(problem, PlanConfig(planner))
    start, goal = np.zeros(3), problem.draw_goal(pipeline.space, np.random.default_rng(0))
    found = planner.plan(pipeline.query(start, goal), np.random.default_rng(0))
    assert isinstance(found, Plan), found
    times = np.arange(len(found.controls) + 1) * pipeline.model.opt.timestep
    states = replay(pipeline.model, pipeline.space, start, found.controls, times)
    assert goal.reached(states[-1:]).all() and np.abs(states[:, 2]).max() > 0.1


@pytest.mark.ompl
@needs_ompl
@pytest.mark.parametrize("algorithm", with_slow(GEOMETRIC_ALGORITHMS, "RRTConnect"))
def test_every_geometric_planner_finds_a_path(algorithm: str, tmp_path: Path) -> None:
    """The goal is on the same side of the post, so that slow machines find a path in time."""
    near = (-0.6, 0.8, 0.0, 1.1, 0.0, 0.0, 0.0)
    problem = replace(load_problem("arm-kinematic"), goal=Box(near, near), tolerance=0.2)
    config = PlanConfig.for_problem(problem, planner=OMPL(algorithm, seconds=3.0), polish_max_iterations=0)
    plan_into(problem, tmp_path, num=1, seed=0, config=config, workers=0)
    episode = load_demos(tmp_path).episode(0)
    assert len(episode.controls) > 10 and np.abs(episode.controls).max() <= 2.0 + 1e-9


@pytest.mark.ompl
@needs_ompl
def test_a_crash_fails_one_plan_and_is_reported(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(process, "_search", _abort)
    problem = load_problem("pendulum")
    config = PlanConfig.for_problem(problem, planner="ompl-rrt")
    with pytest.raises(PartialResult, match=r"1 of 1 plans .*ompl-rrt crashed \(exit code -6\)"):
        plan_into(problem, tmp_path, num=1, seed=0, config=config, workers=0)
    assert "this costs one plan" in capfd.readouterr().err


def _abort(*_: object) -> None:
    os.abort()


@needs_ompl
def test_an_ompl_version_without_the_planner_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "version", lambda _: "2.0.1")
    problem = load_problem("pendulum")
    with pytest.raises(PlanspaceError, match="OMPL 2.0.1 cannot construct SST and PDST.*'ompl==1.7.0'"):
        OMPL("SST").check(problem)
    OMPL("RRT").check(problem)


def test_the_wrong_kind_of_problem_and_missing_ompl_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(UsageError, match="ompl-prm cannot plan a dynamic problem; sst, ompl-sst"):
        OMPL("PRM").check(load_problem("pendulum"))
    with pytest.raises(UsageError, match="ompl-sst cannot plan a kinematic problem; sst, ompl-rrtconnect"):
        OMPL("SST").check(load_problem("arm-kinematic"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(PlanspaceError, match=r"pip install .*\[ompl\]'"):
        OMPL("RRT").check(load_problem("pendulum"))
