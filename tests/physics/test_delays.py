"""States with the controls that delays hold back."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import planspace as ps
from planspace.demos.load import load_demos
from planspace.errors import UsageError
from planspace.mjcf.compile import load_model
from planspace.physics.replay import replay
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.tasks.problem_file import load_problem

MODEL = """<mujoco><compiler angle="radian"/><option timestep="0.02" integrator="{integrator}"/>
  <worldbody><body><joint name="hinge" axis="0 1 0" damping="0.1"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="1"/></body></worldbody>
  <actuator>
    <motor name="late" joint="hinge" ctrlrange="-6 6" delay="0.06" nsample="{count}" interp="{interp}"/>
    <general joint="hinge" dyntype="filter" dynprm="0.1" ctrlrange="-1 1" delay="0.03" nsample="2"/>
  </actuator>
  <keyframe><key name="up" qpos="0" ctrl="0.5 0.25"/></keyframe></mujoco>"""
PROBLEM = """model: late.xml
joints: [hinge]
start: {low: [-3.14, -0.1], high: [3.14, 0.1]}
goal: [0, 0]
tolerance: 0.1
sample_velocity: [10]
"""
NAMES = ("ctrl_late_3", "ctrl_late_2", "ctrl_late_1", "ctrl_2_2", "ctrl_2_1")


def late(integrator: str = "implicitfast", count: int = 3, interp: str = "zoh") -> mujoco.MjModel:
    return load_model(MODEL.format(integrator=integrator, count=count, interp=interp))


def test_a_state_has_the_controls_that_are_held_back() -> None:
    model = late()
    space = StateSpace.from_model(model, ["hinge"])
    assert space.names == ("hinge", "hingevel", "act_2", *NAMES)
    assert space.activations.low[1:].tolist() == [-6, -6, -6, -1, -1]
    weights = [1 / 6 / np.sqrt(3)] * 3 + [1 / np.sqrt(2)] * 2  # each delay spans 2 in all
    np.testing.assert_allclose(space.default_weights(np.ones(1))[-5:], weights)
    simulator = Simulator(model, space, 1, threads=1)
    simulator.reset(np.array([[0.0, 0, 0, 1, 2, 3, 0.1, 0.2]]))
    simulator.step(np.array([[4.0, 0.3]]))
    np.testing.assert_array_equal(simulator.states()[0, 3:], [2, 3, 4, 0.2, 0.3])
    assert simulator.mujoco_data(0).actuator_force[0] == 2.0  # the control of the next step, three steps old


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_a_step_depends_on_nothing_but_the_state(integrator: str, rng: np.random.Generator) -> None:
    model = late(integrator)
    space = StateSpace.from_model(model, ["hinge"])
    controls = rng.uniform(-1, 1, (3000, 2))
    states = replay(model, space, np.zeros(space.size), controls, np.arange(3001) * 0.02)
    simulator = Simulator(model, space, 3000, threads=1)
    simulator.step(np.ones((3000, 2)))
    simulator.reset(states[:-1])
    simulator.step(controls)
    np.testing.assert_array_equal(simulator.states(), states[1:])
    np.testing.assert_array_equal(states[3:, 5], controls[2:, 0])


@pytest.mark.parametrize("change", [{"integrator": "RK4"}, {"count": 5}, {"interp": "linear"}])
def test_delays_that_depend_on_rounding_are_refused(change: dict[str, str]) -> None:
    model = late(**change)  # pyright: ignore[reportArgumentType]
    with pytest.raises(
        UsageError, match=r"'late' has a delay of 0.06 s, .* set nsample=\"3\", interp=\"zoh\""
    ):
        Simulator(model, StateSpace.from_model(model, ["hinge"]), 1, threads=1)


def test_a_delayed_pendulum_is_planned(tmp_path: Path) -> None:
    (tmp_path / "late.xml").write_text(MODEL.format(integrator="implicitfast", count=3, interp="zoh"))
    (tmp_path / "late.yaml").write_text(PROBLEM)
    problem = load_problem(tmp_path / "late.yaml")
    model, space = problem.compile()
    config = PlanConfig.for_problem(problem, restarts=1)
    plan_into(problem, tmp_path / "demos", num=2, seed=0, config=config, workers=1)
    demos = load_demos(tmp_path / "demos")
    for episode in map(demos.episode, range(2)):
        again = replay(model, space, episode.states[0], episode.controls, episode.times)
        np.testing.assert_array_equal(space.difference(again, episode.states), 0.0)
        assert np.abs(episode.states[-1, :2]).sum() <= 0.1
    keyed = PROBLEM.replace("{low: [-3.14, -0.1], high: [3.14, 0.1]}", "{keyframe: up}")
    (tmp_path / "late.yaml").write_text(keyed.replace("goal: [0, 0]", "goal: [1, 0]"))
    assert load_problem(tmp_path / "late.yaml").start.low == (0, 0, 0, 0.5, 0.5, 0.5, 0.25, 0.25)


def test_an_environment_delays_controls_as_the_model_does(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "late.xml").write_text(MODEL.format(integrator="implicitfast", count=3, interp="zoh"))
    (tmp_path / "late.yaml").write_text(PROBLEM + "task: {control_step_s: 0.02}\n")
    env = ps.make_env(tmp_path / "late.yaml")
    _, info = env.reset(seed=0)
    first, controls = info["state"], rng.uniform(-1, 1, (20, 2)).astype(np.float32)
    states = [env.step(control)[4]["state"] for control in controls]
    model = late()
    space = StateSpace.from_model(model, ["hinge"])
    np.testing.assert_allclose(
        np.array([first, *states]),
        replay(model, space, first, controls.astype(float), np.arange(21) * 0.02),
        rtol=0,
        atol=1e-12,
    )
