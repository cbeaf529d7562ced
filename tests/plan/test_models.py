"""Planning over the models that people have: servos, closed loops, and MuJoCo's default time step."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from planspace.errors import PlanspaceError
from planspace.physics.replay import replay
from planspace.physics.simulator import Simulator
from planspace.plan import linearise
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_demos
from planspace.tasks.problem import Box, Problem
from planspace.tasks.problem_file import load_problem

SERVO = """<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/>
  <worldbody><body>
  <joint name="j" axis="0 1 0" range="-2.9 2.9" damping="1"/>
  <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.03" mass="2"/></body></worldbody>
  <actuator><general joint="j" ctrlrange="-2.9 2.9" forcerange="-87 87" biastype="affine" gainprm="2000"
    biasprm="0 -2000 -100"/></actuator></mujoco>"""
PENDULUM = """<mujoco><option timestep="{step}"/><worldbody><body>
  <joint name="j" axis="0 1 0" damping="0.05"/>
  <geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="0.3"/></body></worldbody>
  <actuator><motor joint="j" ctrlrange="-0.5 0.5"/></actuator></mujoco>"""
LOOP = """<mujoco><compiler angle="radian"/><option timestep="0.01"/><worldbody>
  <body><joint name="a" axis="0 1 0" damping="1"/><geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.01"/>
    <body pos="0 0 0.3"><joint name="b" axis="0 1 0" range="-3 3"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.01"/><site name="end" pos="0.5 0 0"/></body></body>
  <body pos="0.5 0 0"><joint name="c" axis="0 1 0" damping="1" range="-3 3"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.01"/><site name="tip" pos="0 0 0.3"/></body>
</worldbody><contact/><equality><connect name="loop" site1="end" site2="tip"/></equality>
<actuator><motor joint="a" ctrlrange="-8 8"/></actuator><option><flag contact="disable"/></option></mujoco>"""


def problem_of(model: str, joints: tuple[str, ...], start: Box, goal: list[float], **more: object) -> Problem:
    center = tuple(map(float, goal))
    return Problem("mine", model, joints, start, Box(center, center), 0.1, **more)  # pyright: ignore


def arm(step: float) -> Problem:
    return problem_of(SERVO.format(step=step), ("j",), Box((-0.5, 0.0), (0.5, 0.0)), [1.5, 0.0])


@pytest.mark.parametrize("step", [0.002, pytest.param(0.01, marks=pytest.mark.slow)])
def test_a_servo_with_a_force_limit_reaches_a_pose(step: float) -> None:
    """From control 0, where the servo is saturated, its force has no slope."""
    problem = arm(step)
    demos = plan_demos(problem, 2, workers=0, verbose=False)
    model, space = demos.info.compile()
    for i in range(2):
        episode = demos.episode(i)
        states = replay(model, space, episode.states[0], episode.controls, episode.times)
        np.testing.assert_allclose(states, episode.states, atol=1e-9)
        assert abs(states[-1, 0] - 1.5) + abs(states[-1, 1]) <= 0.1


def test_the_control_that_holds_a_servo_is_its_target() -> None:
    """Gravity torque at 1.5 rad: 2 * 9.81 * 0.25 * cos(1.5) = 0.347 Nm; a stiffness of 2000 gives it at
    0.17 mrad beyond the pose."""
    model, space = arm(0.002).compile()
    simulator = Simulator(model, space, 8, threads=1)
    pose = np.array([1.5, 0.0])
    assert linearise.forceless_control(simulator, pose) == pytest.approx(1.5)
    held = linearise.equilibrium_control(simulator, pose)
    assert held == pytest.approx(1.5 - 0.347 / 2000, abs=2e-5)


@pytest.mark.nightly
def test_a_pendulum_is_swung_up_at_any_time_step() -> None:
    durations = []
    for step in (0.002, 0.02):
        problem = problem_of(
            PENDULUM.format(step=step),
            ("j",),
            Box((3.0, 0.0), (3.2, 0.0)),
            [0.0, 0.0],
            sample_velocity=(12.0,),
        )
        demos = plan_demos(problem, 2, workers=2, verbose=False)
        assert len(demos) == 2
        durations.append(float(np.median(demos.times[demos.offsets[1:] - 1])))
    assert max(durations) < 1.5 * min(durations)


def test_edges_grow_until_they_leave_their_cell() -> None:
    """A slow robot with the default velocity bound: 0.2 s of its acceleration is less than a witness cell."""
    slow = SERVO.format(step=0.002).split("<actuator>")[0].replace('mass="2"', 'mass="200"')
    slow += '<actuator><motor joint="j" ctrlrange="-9 9"/></actuator></mujoco>'
    slow = slow.replace("implicitfast", 'implicitfast" gravity="0 0 0').replace('""/>', '"/>')
    problem = problem_of(slow, ("j",), Box((0.0, 0.0), (0.0, 0.0)), [0.5, 0.0], hold=False)
    config = PlanConfig.for_problem(problem, restarts=1, polish_max_iterations=0)
    assert len(plan_demos(problem, 1, config=config, workers=0, verbose=False)) == 1


def test_a_start_closes_the_loops_of_the_model() -> None:
    """Starts of all three joints are drawn from a box, in which the loop is torn open."""
    problem = problem_of(
        LOOP,
        ("a", "b", "c"),
        Box((-0.5,) * 3 + (0.0,) * 3, (0.5,) * 3 + (0.0,) * 3),
        [0.9, -0.9, 0.9, 0, 0, 0],
    )
    model, space = problem.compile()
    simulator = Simulator(model, space, 1, threads=1)
    for seed in range(5):
        start = problem.draw_start(simulator, np.random.default_rng(seed))
        assert simulator.constraints.violation(start).size < 1e-3
        data = mujoco.MjData(model)
        space.write(start, data.qpos, data.qvel, data.act)
        mujoco.mj_step(model, data)
        assert np.abs(data.qvel).max() < 0.5  # the loop does not snap shut


YAML = """model: m.xml
joints: [a, b, c]
start: [0, 0, 0, 0, 0, 0]
goal: {goal}
tolerance: 0.1
"""


@pytest.mark.parametrize(
    ("goal", "more", "message"),
    [
        (
            "[0.9, 0.9, 0.9, 0, 0, 0]",
            "",
            "goal: the equality 'loop' of the model does not hold there, by 0.",
        ),
        (
            "[0.9, -0.9, 0.9]",
            "kinematic: true\n",
            "the model has equalities, which a kinematic problem would",
        ),
    ],
)
def test_goals_that_the_model_forbids_are_refused(goal: str, more: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(LOOP)
    text = YAML.format(goal=goal) + more
    if more:
        text = text.replace("start: [0, 0, 0, 0, 0, 0]", "start: [0, 0, 0]")
    (tmp_path / "p.yaml").write_text(text)
    with pytest.raises(PlanspaceError, match=message):
        load_problem(tmp_path / "p.yaml")


def test_a_body_inside_the_floor_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text("""<mujoco><worldbody><geom type="plane" size="1 1 1"/>
      <body pos="0 0 0.5"><joint name="z" type="slide" axis="0 0 1" range="-1 1"/><geom size="0.1"/></body>
      </worldbody><actuator><motor joint="z" ctrlrange="-50 50"/></actuator></mujoco>""")
    text = "model: m.xml\njoints: [z]\nstart: {low: [-1, 0], high: [1, 0]}\ngoal: [%s, 0]\ntolerance: 0.1\n"
    (tmp_path / "p.yaml").write_text(text % -0.5)
    with pytest.raises(
        PlanspaceError, match="goal: the bodies 'world' and 'body1' are inside one another by 0.1"
    ):
        load_problem(tmp_path / "p.yaml")
    (tmp_path / "p.yaml").write_text(text % 0.2)
    problem = load_problem(tmp_path / "p.yaml")
    model, space = problem.compile()
    simulator = Simulator(model, space, 1, threads=1)
    heights = [problem.draw_start(simulator, np.random.default_rng(seed))[0] for seed in range(20)]
    assert min(heights) > -0.42


def test_a_node_in_the_goal_region_is_a_solution_if_the_goal_is_not_held() -> None:
    """Nothing can be held there: the sled passes the goal at any speed, and the regulator has no control."""
    sled = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body>
      <joint name="x" type="slide" axis="1 0 0" range="-2 2"/><geom size="0.1" mass="1"/></body></worldbody>
      <actuator><motor joint="x" ctrlrange="1 2"/></actuator></mujoco>"""
    problem = problem_of(
        sled,
        ("x",),
        Box((-1.0, 0.0), (-1.0, 0.0)),
        [1.0, 0.0],
        goal_weights=(1.0, 0.0),
        sample_velocity=(4.0,),
    )
    quick = {"restarts": 1, "max_rounds": 60, "polish_max_iterations": 0}
    free = replace(problem, hold=False)
    config = PlanConfig.for_problem(free, **quick)
    assert len(plan_demos(free, 1, config=config, workers=0, verbose=False)) == 1
    unheld = pytest.warns(UserWarning, match="does not hold the robot at the goal: after 1 s, 'x' has moved")
    with unheld, pytest.raises(PlanspaceError, match="goal cannot be held"):
        plan_demos(problem, 1, config=PlanConfig.for_problem(problem, **quick), workers=0, verbose=False)
