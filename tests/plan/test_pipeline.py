"""One demonstration: search, polish and proof."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.describe import replay_errors
from planspace.plan import pipeline as module
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import state_info
from planspace.plan.pipeline import Pipeline
from planspace.plan.planner import Failure
from planspace.plan.proof import replay_plan
from planspace.tasks.problem import Box
from planspace.tasks.problem_file import load_problem, shipped_problems

SLOW = {
    "acrobot",
    "arm",
    "arm-kinematic",
}
NIGHTLY = ("hopper-stand", "cheetah-ahead", "finger-spin", "pusher", "quadrotor", "quadrotor-planar")


def marked(name: str) -> Any:
    tier = pytest.mark.nightly if name in NIGHTLY else pytest.mark.slow
    return pytest.param(name, marks=tier) if name in (*SLOW, *NIGHTLY) else name


@pytest.mark.parametrize("name", [marked(name) for name in shipped_problems() if name != "acrobot"])
def test_every_shipped_problem_is_solved(name: str) -> None:
    problem = load_problem(name)
    config = PlanConfig.for_problem(problem, restarts=1, polish_max_iterations=12)
    episode = Pipeline(problem, config).plan(0, 0)
    assert not isinstance(episode, Failure)
    model, space = problem.compile()
    goal = replace(problem.draw_goal(space, np.random.default_rng(0)), center=episode.goal)
    assert goal.reached(episode.states[-1])
    assert not goal.reached(episode.states[:-1]).any()  # the episode ends at its first state in the goal
    np.testing.assert_allclose(np.diff(episode.times), model.opt.timestep)
    info = state_info(problem)
    assert replay_errors(Demos.from_episodes(info, [episode])).max() <= 1e-6
    assert episode.cost == pytest.approx(episode.times[-1])


@pytest.mark.nightly
def test_the_acrobot_is_solved() -> None:
    problem = load_problem("acrobot")
    config = PlanConfig.for_problem(problem, restarts=1, polish_max_iterations=20)
    assert not isinstance(Pipeline(problem, config).plan(0, 0), Failure)


@pytest.mark.slow
def test_of_many_searches_the_two_shortest_paths_are_polished(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = load_problem("pendulum")
    pipeline = Pipeline(problem, PlanConfig.for_problem(problem, restarts=5, polish_max_iterations=3))
    found, polished, search, prove = [], [], module.search, pipeline._prove

    def searching(*given: Any) -> Any:
        found.append(search(*given))
        return found[-1]

    def proving(query: Any, path: Any, rng: Any) -> Any:
        polished.append(path)
        return prove(query, path, rng)

    monkeypatch.setattr(module, "search", searching)
    monkeypatch.setattr(pipeline, "_prove", proving)
    plan = pipeline.plan(0, 0)
    lengths = [len(path.controls) for path in found]
    assert len(set(lengths)) > 2, "the searches should differ"
    assert [len(path.controls) for path in polished] == sorted(lengths)[:2]
    assert not isinstance(plan, Failure)
    assert len(plan.controls) <= min(lengths)


@pytest.mark.nightly
def test_polish_makes_plans_shorter_and_restarts_never_longer() -> None:
    problem = load_problem("cartpole-swingup")
    lengths = {}
    for key, config in {
        "tree": PlanConfig.for_problem(problem, polish_max_iterations=0, restarts=1),
        "one": PlanConfig.for_problem(problem, restarts=1),
        "two": PlanConfig.for_problem(problem, restarts=2),
    }.items():
        plans = [Pipeline(problem, config).plan(0, index) for index in range(3)]
        assert not any(isinstance(plan, Failure) for plan in plans)
        lengths[key] = np.array([len(plan.controls) for plan in plans])  # pyright: ignore
    assert lengths["one"].sum() < 0.7 * lengths["tree"].sum()
    assert (lengths["two"] <= lengths["one"]).all()


def test_a_start_in_the_goal_region_is_drawn_again() -> None:
    problem = load_problem("pendulum")
    near = replace(problem, start=Box((-0.2, 0.0), (0.2, 0.0)))  # half of the starts are within 0.1
    planner = Pipeline(near, PlanConfig.for_problem(near, restarts=1))
    for index in range(4):
        plan = planner.plan(0, index)
        assert not isinstance(plan, Failure) and plan.seed == 0 and abs(plan.states[0, 0]) > 0.1
    rng = np.random.default_rng(0)
    inside = planner.connect(np.zeros(2), near.draw_goal(planner.space, rng), rng)
    assert isinstance(inside, Failure) and inside.reason == "the start lies in the goal region"


def test_states_while_holding_must_be_valid() -> None:
    """A cart that arrives too fast: it would go through the wall before it returns to the goal."""
    wall = """<mujoco><worldbody>
      <body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body></worldbody>
      <actuator><motor joint="x" ctrllimited="true" ctrlrange="-20 20"/></actuator></mujoco>"""
    problem = replace(
        load_problem("pendulum"), model=wall, joints=("x",), start=Box((0.0, 0.0), (0.0, 0.0)),
        goal=Box((0.95, 0.0), (0.95, 0.0)), goal_weights=(1.0, 0.0), tolerance=0.05,
        position_bounds=(("x", (-1.0,), (1.0,)),), sample_velocity=(5.0,),
    )  # fmt: skip
    planner = Pipeline(problem, PlanConfig.for_problem(problem))
    goal = problem.draw_goal(planner.space, np.random.default_rng(0))
    query = planner.query(np.zeros(2), goal)
    fast = np.full((250, 1), 20.0)  # at 20 m/s^2 it is 6 m/s fast after 0.9 m
    failed = replay_plan(query, fast)
    assert isinstance(failed, Failure) and "cannot be held" in failed.reason
    brakes = np.concatenate([np.full((215, 1), 5.0), np.full((215, 1), -5.0)])  # at rest after 0.92 m
    assert not isinstance(replay_plan(query, brakes), Failure)


@pytest.mark.nightly
def test_with_hold_false_a_goal_may_be_passed_through() -> None:
    """A goal with a moving, horizontal pole cannot be held, so with `hold` no plan is accepted."""
    problem = load_problem("cartpole-swingup")
    through = (0.0, 1.57, 0.0, -3.0)
    moving = replace(problem, goal=Box(through, through), goal_weights=(0.2, 1.0, 0.2, 0.2), tolerance=0.2)
    config = PlanConfig.for_problem(moving, restarts=1, max_rounds=40)
    held = Pipeline(moving, config).plan(0, 0)
    assert isinstance(held, Failure) and "cannot be held" in held.reason
    assert not isinstance(Pipeline(replace(moving, hold=False), config).plan(0, 0), Failure)


@pytest.mark.slow
def test_quaternions_are_stored_without_sign_changes_and_end_with_positive_w() -> None:
    problem = load_problem("ball-pendulum")
    episode = Pipeline(problem, PlanConfig.for_problem(problem, restarts=1)).plan(0, 1)
    assert not isinstance(episode, Failure)
    q = episode.states[:, :4]
    assert (np.einsum("ti,ti->t", q[1:], q[:-1]) > 0.9).all() and q[-1, 0] > 0
