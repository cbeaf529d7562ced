import importlib.metadata
import importlib.util
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.folder import load_demos
from planspace.errors import PartialResult, PlanspaceError, UsageError
from planspace.plan import ompl
from planspace.plan.generate import generate
from planspace.plan.ompl import CONTROL_PLANNERS, GEOMETRIC_PLANNERS, OMPLConfig, check_ompl, plan_in_process
from planspace.plan.planner import PlannerConfig
from planspace.tasks.problem import Box, Goal, Problem
from planspace.tasks.problem_file import load_problem

needs_ompl = pytest.mark.skipif(importlib.util.find_spec("ompl") is None, reason="needs the extra ompl")


def ask(
    problem: Problem, planner: str, start: np.ndarray, tolerance: float, seed: int = 1, seconds: float = 3.0
):
    space = problem.compile()[1]
    n = space.tangent_size
    goal = problem.draw_goal(space, np.random.default_rng(0))
    goal = Goal(space, goal.center, np.zeros(n), goal.weights, tolerance)
    return plan_in_process(problem, planner, OMPLConfig(seconds=seconds), start, goal, seed), goal


@pytest.mark.ompl
@needs_ompl
@pytest.mark.parametrize("planner", CONTROL_PLANNERS)
def test_every_control_planner_finds_an_easy_way(planner: str) -> None:
    """A pendulum near the top, to within a generous 0.4."""
    problem = load_problem("pendulum")
    start = np.array([0.25, 0.6])
    search, goal = ask(problem, planner, start, 0.4)
    assert search.arrived, search.note
    model, space = problem.compile()
    from planspace.physics.replay import replay

    times = np.arange(len(search.controls) + 1) * model.opt.timestep
    states = replay(model, space, start, search.controls, times)
    assert goal.reached(states[-1:]).all()
    assert search.cost == pytest.approx(times[-1]) and search.nearest <= 0.4


@pytest.mark.ompl
@needs_ompl
@pytest.mark.parametrize("planner", GEOMETRIC_PLANNERS)
def test_every_geometric_planner_finds_a_way(planner: str, tmp_path: Path) -> None:
    """On the near side of the post: a slow machine must find it too."""
    near = (-0.6, 0.8, 0.0, 1.1, 0.0, 0.0, 0.0)
    problem = replace(load_problem("arm-kinematic"), goal=Box(near, near), tolerance=0.2)
    config = PlannerConfig.for_problem(problem, planner=planner, ompl_seconds=3.0, polish_max_iterations=0)
    generate(problem, tmp_path, num=1, seed=0, config=config, workers=0)
    episode = load_demos(tmp_path).episode(0)
    assert len(episode.controls) > 10 and np.abs(episode.controls).max() <= 2.0 + 1e-9


@pytest.mark.ompl
@needs_ompl
def test_a_crash_costs_one_plan_and_is_reported(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(ompl, "_child", _abort)
    problem = load_problem("pendulum")
    config = PlannerConfig.for_problem(problem, planner="ompl-rrt")
    with pytest.raises(PartialResult, match=r"1 of 1 plans .*ompl-rrt crashed \(exit code -6\)"):
        generate(problem, tmp_path, num=1, seed=0, config=config, workers=0)
    assert "this costs one plan" in capfd.readouterr().err


def _abort(*_: object) -> None:
    os.abort()


@needs_ompl
def test_other_versions_say_which_has_the_planner(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "version", lambda _: "2.0.1")
    problem = load_problem("pendulum")
    with pytest.raises(PlanspaceError, match="OMPL 2.0.1 cannot construct SST and PDST.*'ompl==1.7.0'"):
        check_ompl("ompl-sst", problem)
    check_ompl("ompl-rrt", problem)


def test_a_planner_for_the_other_kind_of_problem_and_a_missing_ompl_are_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(UsageError, match="ompl-prm cannot plan a dynamic problem; sst, ompl-sst"):
        check_ompl("ompl-prm", load_problem("pendulum"))
    with pytest.raises(UsageError, match="ompl-sst cannot plan a kinematic problem; sst, ompl-rrtconnect"):
        check_ompl("ompl-sst", load_problem("arm-kinematic"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(PlanspaceError, match=r"pip install 'planspace\[ompl\]'"):
        check_ompl("ompl-rrt", load_problem("pendulum"))
