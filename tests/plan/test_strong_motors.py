"""Arms whose motors are far too strong for their wrists, as in many published models."""

import numpy as np
import pytest

from planspace.physics.simulator import Simulator
from planspace.plan.computed_torque import ComputedTorque
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_demos
from planspace.plan.motors import limit_accelerations
from planspace.tasks.problem import Box, Goal, Problem
from planspace.tasks.problem_file import load_problem

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002"><flag contact="disable"/></option>
<default><joint range="-3 3" damping="0.001" frictionloss="0.01"/><geom size="0.03" mass="2"/></default>
<worldbody><body><joint name="a" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 0 0 0.2"/>
<body pos="0 0 0.2"><joint name="b" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.4 0 0"/>
<body pos="0.4 0 0"><joint name="c" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0"/>
<body pos="0.3 0 0"><joint name="d" axis="1 0 0"/><geom type="capsule" fromto="0 0 0 0.05 0 0" mass="0.1"/>
<body pos="0.05 0 0"><joint name="e" axis="0 1 0"/><geom type="sphere" pos="0.02 0 0" mass="0.05"/>
<body pos="0.04 0 0"><joint name="f" axis="1 0 0"/><geom type="sphere" size="0.02" mass="0.05"/>
</body></body></body></body></body></body></worldbody>
<actuator><motor joint="a" ctrlrange="-150 150"/><motor joint="b" ctrlrange="-150 150"/>
<motor joint="c" gear="-2" ctrlrange="-40 40"/><motor joint="d" ctrlrange="-28 28"/>
<motor joint="e" ctrlrange="-28 28"/><motor joint="f" ctrlrange="-28 28"/></actuator></mujoco>"""
JOINTS = ("a", "b", "c", "d", "e", "f")
START, GOAL = (-1.5,) * 6 + (0.0,) * 6, (1.5,) * 6 + (0.0,) * 6


def problem() -> Problem:
    return Problem("strong", ARM, JOINTS, Box(START, START), Box(GOAL, GOAL), 0.1)


def test_only_motors_that_are_far_too_strong_are_limited() -> None:
    model, space = problem().compile()
    limit_accelerations(model, space)
    low, high = model.actuator_ctrlrange.T
    np.testing.assert_array_equal(high[:3], (150.0, 150.0, 40.0))
    assert (high[3:] < 28.0).all()
    assert (low == -high).all()
    assert high[5] == pytest.approx(1000.0 * 0.4 * 0.05 * 0.02**2 + 0.01, rel=0.01)  # inertia of a sphere


@pytest.mark.parametrize("name", ["cheetah-ahead", "arm", "hopper-stand", "reacher"])
def test_shipped_models_keep_their_ranges(name: str) -> None:
    model, space = load_problem(name).compile()
    before = model.actuator_ctrlrange.copy()
    limit_accelerations(model, space)
    np.testing.assert_array_equal(model.actuator_ctrlrange, before)


def test_computed_torque_drives_across_half_of_the_range() -> None:
    """Against gravity and dry friction; a motor turns backwards, and the joints are not in order."""
    given = problem()
    shuffled = Problem("strong", ARM, JOINTS[::-1], given.start, given.goal, 0.1)
    model, space = shuffled.compile()
    simulator = Simulator(model, space, 2)
    torque = ComputedTorque(simulator)
    assert torque.fits
    starts = np.array([START, GOAL])
    controls, steps, arrived = torque.finish(
        Goal(space, np.array(GOAL), np.zeros(12), np.ones(12), 0.1), starts
    )
    assert arrived.all()
    assert steps[1] == 0 < steps[0] < 1000
    simulator.reset(starts)
    for control in controls[0, : steps[0]]:
        simulator.step(np.stack([control, control]))
    assert np.abs(simulator.states()[0] - GOAL).sum() <= 0.1


@pytest.mark.parametrize("name", ["acrobot", "cartpole-swingup", "quadrotor", "hopper-stand"])
def test_underactuated_robots_have_no_computed_torque(name: str) -> None:
    assert not ComputedTorque(Simulator(*load_problem(name).compile(), 1)).fits


@pytest.mark.nightly
def test_an_arm_with_strong_wrists_reaches_across_half_of_its_range() -> None:
    demos = plan_demos(problem(), 1, config=PlanConfig(restarts=1), workers=0, verbose=False)
    assert np.abs(demos.episode(0).states[-1] - GOAL).sum() <= 0.1
