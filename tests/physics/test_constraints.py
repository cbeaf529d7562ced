import mujoco
import numpy as np
import pytest

from planspace.mjcf.compile import load_model
from planspace.physics.constraints import Constraints
from planspace.physics.space import StateSpace

FOUR_BAR = """<mujoco><worldbody>
  <body><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.01"/>
    <body pos="0 0 0.3"><joint name="b" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.01"/>
      <site name="end" pos="0.5 0 0"/></body></body>
  <body name="crank" pos="0.5 0 0"><joint name="c" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.01"/><site name="tip" pos="0 0 0.3"/></body>
</worldbody><equality><connect name="loop" site1="end" site2="tip"/></equality></mujoco>"""


def constraints_of(text: str, joints: tuple[str, ...]) -> Constraints:
    model = load_model(text)
    return Constraints(model, StateSpace.from_model(model, joints))


def test_the_violation_of_a_loop_by_hand() -> None:
    """The crank alone turns by 0.1 rad about y: its tip moves by 0.3 sin 0.1 along x."""
    loop = constraints_of(FOUR_BAR, ("a", "b", "c"))
    assert loop.has_equalities
    assert loop.violation(np.zeros(6)).size < 1e-12
    size, name = loop.violation(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    assert name == "loop" and size == pytest.approx(0.3 * np.sin(0.1))


def test_a_torn_loop_is_closed_and_its_velocity_stays_in_the_loop() -> None:
    loop = constraints_of(FOUR_BAR, ("a", "b", "c"))
    torn = np.array([0.3, 0.0, 0.1, 1.0, 0.0, 0.0])
    closed = loop.project(torn)
    assert closed is not None and loop.violation(closed).size < 1e-3
    assert np.abs(closed[:3] - torn[:3]).max() < 0.5
    # in a parallelogram, both cranks turn equally fast and the bar between them does not turn
    a, b, c = closed[3:]
    np.testing.assert_allclose((b, c), (-a, a), atol=0.05)


def test_a_loop_that_cannot_close_is_reported() -> None:
    short = FOUR_BAR.replace('site name="end" pos="0.5 0 0"', 'site name="end" pos="0.5 0.2 0"')
    assert constraints_of(short, ("a", "b", "c")).project(np.zeros(6)) is None


def test_coupled_joints_are_brought_together() -> None:
    text = """<mujoco><worldbody><body><joint name="x" type="slide"/><geom size="0.1"/></body>
      <body pos="1 0 0"><joint name="y" type="slide"/><geom size="0.1"/></body></worldbody>
      <equality><joint joint1="x" joint2="y"/></equality></mujoco>"""
    coupled = constraints_of(text, ("x", "y"))
    assert coupled.violation(np.array([0.0, 0.04, 0.0, 0.0])) == (pytest.approx(0.04), "joint 0")
    closed = coupled.project(np.array([0.0, 0.04, 1.0, 0.0]))
    np.testing.assert_allclose(closed, [0.02, 0.02, 0.5, 0.5], atol=1e-4)


def test_the_depth_of_overlapping_bodies() -> None:
    text = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
      <body pos="0 0 0.1"><joint name="z" type="slide" axis="0 0 1"/><geom size="0.1"/></body>
      </worldbody></mujoco>"""
    floor = constraints_of(text, ("z",))
    assert floor.overlap(np.array([-0.03, 0.0])) == (pytest.approx(0.03), ("world", "body1"))
    assert floor.overlap(np.array([0.5, 0.0])) == (0.0, ())


def test_sparse_models_give_the_same_projection() -> None:
    dense = constraints_of(FOUR_BAR, ("a", "b", "c"))
    sparse = constraints_of(
        FOUR_BAR.replace("<mujoco>", '<mujoco><option jacobian="sparse"/>'), ("a", "b", "c")
    )
    assert mujoco.mj_isSparse(load_model(FOUR_BAR)) == 0
    torn = np.array([0.3, 0.0, 0.1, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(sparse.project(torn), dense.project(torn), atol=1e-9)
