"""Shortcuts by simulation."""

from dataclasses import replace

import numpy as np

from planspace.physics.simulator import Simulator
from planspace.plan.config import PlanConfig, PolishConfig
from planspace.plan.pipeline import Pipeline
from planspace.plan.shortcut import Shortcut, has_contacts
from planspace.tasks.problem import Box, Problem
from planspace.tasks.problem_file import load_problem

PUSH = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody>
  <body name="hand"><joint name="hand" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
  <body name="block" pos="0.5 0 0"><joint name="block" type="slide" axis="1 0 0" damping="2"/>
    <geom type="box" size="0.1 0.1 0.1" mass="1"/></body></worldbody>
  <actuator><motor joint="hand" ctrllimited="true" ctrlrange="-10 10"/></actuator></mujoco>"""
SLIDES = (("hand", (-1.0,), (2.0,)), ("block", (-1.0,), (2.0,)))


def pushing() -> Problem:
    """A hand that pushes a block 0.5 m along a line; they touch after 0.3 m."""
    goal = (0.0, 0.5, 0.0, 0.0)
    return replace(
        load_problem("reacher"), model=PUSH, joints=("hand", "block"), start=Box((0.0,) * 4, (0.0,) * 4),
        goal=Box(goal, goal), goal_weights=(0.0, 1.0, 0.0, 0.0), tolerance=0.05, position_bounds=SLIDES,
        feature_weights=(), sample_velocity=(), hold=False,
    )  # fmt: skip


def test_a_detour_is_cut_out() -> None:
    """Full force all the time is best: it is the only control, and nothing limits the speed."""
    problem = pushing()
    model, space = problem.compile()
    simulator = Simulator(model, space, 64, threads=1)
    goal = problem.draw_goal(space, np.random.default_rng(0))
    full = np.full((100, 1), 10.0)
    detour = np.concatenate([np.full((20, 1), -3.0), np.full((20, 1), 3.0), np.full((100, 1), 6.0)])
    cut = Shortcut(simulator, goal, PolishConfig(shortcut_rounds=60), np.random.default_rng(0))
    best = cut._best(np.zeros(4), full[None])
    found = cut.run(np.zeros(4), detour)
    assert best is not None and found is not None
    assert len(best.controls) <= len(found) <= 1.1 * len(best.controls)
    assert cut.run(np.zeros(4), best.controls) is None  # nothing is shorter
    assert cut.run(np.zeros(4), np.zeros((50, 1))) is None  # it does not reach the goal


def test_only_plans_with_contacts_are_changed() -> None:
    problem = pushing()
    pipeline = Pipeline(problem, PlanConfig.for_problem(problem, restarts=1), threads=1)
    query = pipeline.query(np.zeros(4), problem.draw_goal(pipeline.space, np.random.default_rng(0)))
    assert has_contacts(query, np.full((100, 1), 10.0))
    assert not has_contacts(query, np.full((5, 1), 10.0))


def test_a_block_is_pushed_by_contact() -> None:
    problem = pushing()
    plan = Pipeline(problem, PlanConfig.for_problem(problem, restarts=1), threads=1).plan(0, 0)
    assert abs(plan.states[-1, 1] - 0.5) <= 0.05  # pyright: ignore[reportAttributeAccessIssue]
