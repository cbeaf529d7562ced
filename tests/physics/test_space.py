import numpy as np
import pytest

from planspace.errors import UsageError
from planspace.physics.simulate import load_model
from planspace.physics.space import StateSpace
from planspace.plan.problem import load_problem
from planspace.tasks import TASKS


@pytest.fixture
def cartpole() -> StateSpace:
    return TASKS["cartpole"].compile()[1]


def test_reads_joint_kinds_off_the_model(cartpole: StateSpace) -> None:
    assert cartpole.names == ("slider", "hinge", "slidervel", "hingevel")
    assert cartpole.units == ("m", "rad", "m/s", "rad/s")
    assert cartpole.circular_columns == (1,)  # the hinge has no limit: SO(2)
    assert (cartpole.low[0], cartpole.high[0]) == (-1.0, 1.0)
    reacher = TASKS["reacher-raw"].compile()[1]
    assert reacher.circular_columns == ()  # both joints are limited: bounded R
    np.testing.assert_allclose(reacher.high, [3.14, 3.0])


def test_distance_goes_the_short_way_round(cartpole: StateSpace) -> None:
    a, b = np.array([0.0, 3.0, 0.0, 0.0]), np.array([0.5, -3.0, 0.0, 1.0])
    # |0.5| + |6 - 2 pi| + 0 + |1|
    assert cartpole.distance(a, b) == pytest.approx(0.5 + (2 * np.pi - 6) + 1.0)
    wound = a + np.array([0.0, 8 * np.pi, 0.0, 0.0])
    assert cartpole.distance(wound, b) == pytest.approx(float(cartpole.distance(a, b)))
    assert cartpole.distance(wound, b) > 0  # the 2020 planner's went negative here


def test_features_do_not_see_windings(cartpole: StateSpace) -> None:
    weights = np.array([1.0, 2.0, 0.5, 0.1])
    x = np.array([0.1, 0.4, 2.0, 3.0])
    expected = [0.1, 2 * np.sin(0.4), 2 * np.cos(0.4), 1.0, 0.3]
    np.testing.assert_allclose(cartpole.features(x, weights), expected)
    np.testing.assert_allclose(cartpole.features(x + [0, 2 * np.pi, 0, 0], weights), expected, atol=1e-12)


def test_bounds_refuse_limits_speed_and_nan(cartpole: StateSpace) -> None:
    states = np.array(
        [[0, 100, 0, 0], [1.01, 0, 0, 0], [0, 0, 0, 50.1], [0, np.nan, 0, 0], [0, 0, np.inf, 0]], float
    )
    assert cartpole.in_bounds(states).tolist() == [True, False, False, False, False]


def test_unknown_and_ball_joints_are_refused_by_name() -> None:
    model, _ = load_problem("cartpole").compile()
    with pytest.raises(UsageError, match="unknown joint 'hinje'. Did you mean 'hinge'"):
        StateSpace.from_model(model, ["slider", "hinje"])
    ball = load_model(
        "<mujoco><worldbody><body><joint name='b' type='ball'/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(UsageError, match="joint 'b' is a ball or free joint"):
        StateSpace.from_model(ball, ["b"])
