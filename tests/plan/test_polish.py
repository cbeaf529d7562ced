from dataclasses import replace

import numpy as np
import pytest

from planspace.physics.simulator import Simulator
from planspace.plan import linearise
from planspace.plan.clearance import Clearance
from planspace.plan.config import PlanConfig, PolishConfig, RegulatorConfig
from planspace.plan.polish import Polish
from planspace.plan.polish_program import Limits, LinearModel, solve_program
from planspace.plan.query import Query
from planspace.plan.regulator import Regulator
from planspace.plan.sst import SST
from planspace.plan.sst_search import SSTSearch
from planspace.plan.trajectory import Trajectory
from planspace.tasks.problem import Box, Goal, Problem
from planspace.tasks.problem_file import load_problem


def make(problem: Problem) -> Simulator:
    model, space = problem.compile()
    return Simulator(model, space, 256, threads=1, validity=problem.validity)


def rolled(simulator: Simulator, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
    ids, states = np.array([0], dtype=np.int32), [start]
    simulator.reset(start[None], ids)
    for control in controls:
        simulator.step(control[None], ids=ids)
        states.append(simulator.states()[0])
    return np.stack(states)


def tree_plan(problem: Problem, simulator: Simulator, start: np.ndarray, goal: Goal) -> np.ndarray:
    regulator = Regulator(simulator, goal, problem.weights(simulator.space), RegulatorConfig())
    query = Query(problem, start, goal, simulator, regulator)
    return SSTSearch(SST(extensions=256, max_rounds=60), query, np.random.default_rng(0)).solve().controls


def test_a_double_integrator_reaches_its_shortest_time() -> None:
    """The reacher's joints are double integrators to 1 %: its best time is known.

    One joint from rest to rest over d rad with |acceleration| <= 200 takes 2 sqrt(d / 200) without damping:
    over 2 rad 0.2 s, 20 steps; the tolerance of 0.1 and the velocity left in it save about one.
    """
    problem = load_problem("reacher")
    simulator = make(problem)
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    start = np.array([2.0, 1.57, 0.0, 0.0])
    wandering = tree_plan(problem, simulator, start, goal)
    controls = Polish(simulator, goal, problem.weights(simulator.space), PolishConfig()).run(start, wandering)
    assert controls is not None
    assert goal.reached(rolled(simulator, start, controls)[-1])
    assert 18 <= len(controls) <= 21 < len(wandering)


def test_velocities_stay_within_their_bounds_if_the_polish_sees_them() -> None:
    """A joint that may turn at 8 rad/s takes d / v + v / a = 0.25 + 0.04 s over 2 rad: 29 steps.

    The tolerance of 0.1 and the velocity left in it save one or two, the margin costs one. Without the margin
    changes that exceed the bound are only rejected.
    """
    problem = replace(load_problem("reacher"), velocity_bound=(8.0,))
    simulator = make(problem)
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    start = np.array([2.0, 1.57, 0.0, 0.0])
    wandering = tree_plan(problem, simulator, start, goal)
    lengths = []
    for margin in (0.01, 0.0):
        config = PolishConfig(velocity_margin=margin)
        polish = Polish(simulator, goal, problem.weights(simulator.space), config)
        controls = polish.run(start, wandering)
        assert controls is not None
        states = rolled(simulator, start, controls)
        assert goal.reached(states[-1]) and simulator.space.in_bounds(states).all()
        lengths.append(len(controls))
    assert 26 <= lengths[0] <= 30 < lengths[1]


@pytest.mark.nightly
def test_a_swing_up_gets_shorter_and_stays_within_its_limits() -> None:
    problem = load_problem("cartpole-swingup")
    simulator, start = make(problem), np.array([0.15, np.pi, 0.0, 0.0])
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    wandering = tree_plan(problem, simulator, start, goal)
    controls = Polish(simulator, goal, problem.weights(simulator.space), PolishConfig()).run(start, wandering)
    assert controls is not None
    states = rolled(simulator, start, controls)
    assert goal.reached(states[-1]) and not goal.reached(states[:-1]).any()
    assert simulator.space.in_bounds(states).all() and np.abs(controls).max() <= 3.0
    assert len(controls) <= 0.75 * len(wandering)


def test_effort_is_reduced_at_the_same_duration() -> None:
    problem = replace(load_problem("reacher"), cost="effort")
    simulator = make(problem)
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    start = np.array([2.0, 1.57, 0.0, 0.0])
    wandering = tree_plan(problem, simulator, start, goal)
    polish = Polish(simulator, goal, problem.weights(simulator.space), PolishConfig(), effort=True)
    controls = polish.run(start, wandering)
    assert controls is not None
    assert goal.reached(rolled(simulator, start, controls)[-1])
    assert np.abs(controls).sum() < 0.7 * np.abs(wandering).sum()


@pytest.mark.nightly  # a path that is too short, below, is corrected alike
def test_a_plan_that_misses_its_goal_is_corrected() -> None:
    problem = load_problem("cartpole-swingup")
    simulator, start = make(problem), np.array([0.15, np.pi, 0.0, 0.0])
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    near = tree_plan(problem, simulator, start, goal)[:-12]  # without the end of its tail
    assert not goal.reached(rolled(simulator, start, near)).any()
    controls = Polish(simulator, goal, problem.weights(simulator.space), PolishConfig()).run(start, near)
    assert controls is not None and goal.reached(rolled(simulator, start, controls)[-1])


@pytest.mark.nightly
def test_long_plans_are_polished_in_blocks() -> None:
    problem = load_problem("cartpole-swingup")
    simulator, start = make(problem), np.array([0.15, np.pi, 0.0, 0.0])
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    wandering = tree_plan(problem, simulator, start, goal)
    config = PolishConfig(max_blocks=len(wandering) // 2)  # blocks of three steps
    controls = Polish(simulator, goal, problem.weights(simulator.space), config).run(start, wandering)
    assert controls is not None and goal.reached(rolled(simulator, start, controls)[-1])
    assert len(controls) % 3 == 0 and len(controls) < len(wandering)
    np.testing.assert_array_equal(controls[::3], controls[1::3])


def test_polish_fails_if_the_goal_is_out_of_reach() -> None:
    problem = load_problem("reacher")
    simulator = make(problem)
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    polish = Polish(simulator, goal, problem.weights(simulator.space), PolishConfig(repairs=0))
    assert polish.run(np.array([2.0, 1.57, 0.0, 0.0]), np.zeros((5, 2))) is None  # 2 rad in 0.05 s
    assert polish.run(np.array([2.0, 1.57, 0.0, 0.0]), np.zeros((0, 2))) is None


def test_a_path_that_is_too_short_is_continued_to_the_goal() -> None:
    """The shortest plan takes 20 steps; see above."""
    problem, start = load_problem("reacher"), np.array([2.0, 1.57, 0.0, 0.0])
    simulator = make(problem)
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    polish = Polish(simulator, goal, problem.weights(simulator.space), PolishConfig(repairs=40))
    controls = polish.run(start, np.zeros((5, 2)))
    assert controls is not None and goal.reached(rolled(simulator, start, controls)[-1])
    assert 18 <= len(controls) <= 21


POINT_BESIDE_A_BOX = """<mujoco>
  <option timestep="0.02" gravity="0 0 0"><flag autoreset="disable"/></option>
  <worldbody>
    <geom name="box" type="box" size="0.3 0.3 0.3"/>
    <body name="point">
      <joint name="x" type="slide" axis="1 0 0" range="-2 2"/>
      <joint name="y" type="slide" axis="0 1 0" range="-2 2"/>
      <geom name="point" type="sphere" size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="x" joint="x" ctrllimited="true" ctrlrange="-5 5"/>
    <motor name="y" joint="y" ctrllimited="true" ctrlrange="-5 5"/>
  </actuator>
</mujoco>"""


def test_a_path_that_stops_before_a_box_is_repaired_around_it() -> None:
    """Over 2 m with at most 5 m/s^2 it takes at least 2 sqrt(2 / 5) = 1.26 s, 63 steps, without the box; the
    tolerance and the velocity left in it save some."""
    start, end = (-1.0, 0.1, 0.0, 0.0), (1.0, 0.1, 0.0, 0.0)
    problem = Problem(
        "point",
        POINT_BESIDE_A_BOX,
        ("x", "y"),
        Box(start, start),
        Box(end, end),
        tolerance=0.1,
        velocity_bound=(3.0,),
        forbidden_contacts="all",
    )
    simulator = make(problem)
    goal = problem.draw_goal(simulator.space, np.random.default_rng(0))
    clearance, found = Clearance(problem, simulator.space, threads=1), []
    for repairs in (0, 40):
        weights, config = problem.weights(simulator.space), PolishConfig(repairs=repairs)
        polish = Polish(simulator, goal, weights, config, clearance=clearance)
        found.append(polish.run(np.array(start), np.zeros((5, 2))))
    assert found[0] is None and found[1] is not None
    states = rolled(simulator, np.array(start), found[1])
    assert goal.reached(states[-1]) and simulator.valid_states(states).all()
    assert 58 <= len(found[1]) <= 68


@pytest.mark.parametrize("name", ["arm", pytest.param("quadrotor", marks=pytest.mark.nightly)])
@pytest.mark.slow
def test_plans_with_contacts_and_rotations_get_shorter_and_stay_valid(name: str) -> None:
    problem = load_problem(name)
    simulator, config = make(problem), PlanConfig.for_problem(problem)
    rng = np.random.default_rng(1)
    start, goal = problem.draw_start(simulator, rng), problem.draw_goal(simulator.space, rng)
    weights = problem.weights(simulator.space)
    regulator = Regulator(simulator, goal, weights, config.regulator)
    query = Query(problem, start, goal, simulator, regulator)
    search = SSTSearch(replace(config.planner, extensions=256), query, rng).solve()  # pyright: ignore
    assert search.arrived
    clearance = Clearance(problem, simulator.space, threads=1) if name.startswith("arm") else None
    few = replace(config.polish, max_iterations=15)
    polish = Polish(simulator, goal, weights, few, clearance=clearance)
    controls = polish.run(start, search.controls)
    assert controls is not None and len(controls) < 0.8 * len(search.controls)
    states = rolled(simulator, start, controls)
    assert goal.reached(states[-1]) and simulator.valid_states(states).all()


def test_a_linear_model_without_a_solution_has_no_feedback() -> None:
    """A control without cost and effect: the equations of its gain are singular."""
    gains = linearise.time_varying_lqr(np.ones((3, 2, 2)), np.zeros((3, 2, 1)), np.ones(2), np.zeros(1))[0]
    np.testing.assert_array_equal(gains, np.zeros((3, 1, 2)))


def test_a_linear_model_that_overflows_changes_nothing() -> None:
    """Along an unstable motion the sensitivities grow a thousandfold per step, beyond what a float holds."""
    problem = load_problem("reacher")
    simulator = make(problem)
    space, count, controls = simulator.space, 120, np.zeros((120, 2))
    sensitivities = linearise.sensitivities(np.tile(1e3 * np.eye(4), (count, 1, 1)), np.ones((count, 4, 2)))
    assert not np.isfinite(sensitivities).all()
    none = np.empty((count + 1, 0))
    model = LinearModel(np.zeros((count, 2, 4)), sensitivities, none, none[..., None])
    goal = problem.draw_goal(space, np.random.default_rng(0))
    limits = Limits(space, goal, np.full(2, -1.0), np.full(2, 1.0))
    plan = Trajectory(np.zeros((count + 1, 4)), controls)
    assert solve_program(limits, plan, model, count, 1.0, effort=False) is None
    assert solve_program(limits, plan, model, count, 1.0, effort=True) is None
    assert solve_program(limits, plan, model, 2, 1.0, effort=False) is not None
