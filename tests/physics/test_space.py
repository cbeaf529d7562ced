import mujoco
import numpy as np
import pytest

from planspace.errors import UsageError
from planspace.mjcf.compile import load_model
from planspace.physics.space import StateSpace
from planspace.tasks.catalog import TASKS
from planspace.tasks.problem_file import load_problem


@pytest.fixture
def cartpole() -> StateSpace:
    return TASKS["cartpole"].compile()[1]


def test_joint_kinds_are_read_from_the_model(cartpole: StateSpace) -> None:
    assert cartpole.names == ("slider", "hinge", "slidervel", "hingevel")
    assert cartpole.units == ("m", "rad", "m/s", "rad/s")
    assert cartpole.circular_columns == (1,)  # the hinge has no limit: SO(2)
    assert (cartpole.low[0], cartpole.high[0]) == (-1.0, 1.0)
    reacher = TASKS["reacher-raw"].compile()[1]
    assert reacher.circular_columns == ()  # both joints are limited: bounded R
    np.testing.assert_allclose(reacher.high, [3.14, 3.0])


def test_distance_takes_the_short_way_round(cartpole: StateSpace) -> None:
    a, b = np.array([0.0, 3.0, 0.0, 0.0]), np.array([0.5, -3.0, 0.0, 1.0])
    # |0.5| + |6 - 2 pi| + 0 + |1|
    assert cartpole.distance(a, b) == pytest.approx(0.5 + (2 * np.pi - 6) + 1.0)
    with_winding = a + np.array([0.0, 8 * np.pi, 0.0, 0.0])
    assert cartpole.distance(with_winding, b) == pytest.approx(float(cartpole.distance(a, b)))
    assert cartpole.distance(with_winding, b) > 0  # the 2020 planner's was negative here


def test_features_ignore_windings(cartpole: StateSpace) -> None:
    weights = np.array([1.0, 2.0, 0.5, 0.1])
    x = np.array([0.1, 0.4, 2.0, 3.0])
    expected = [0.1, 2 * np.sin(0.4), 2 * np.cos(0.4), 1.0, 0.3]
    np.testing.assert_allclose(cartpole.features(x, weights), expected)
    np.testing.assert_allclose(cartpole.features(x + [0, 2 * np.pi, 0, 0], weights), expected, atol=1e-12)


def test_states_out_of_bounds_too_fast_or_nan_are_invalid(cartpole: StateSpace) -> None:
    states = np.array(
        [[0, 100, 0, 0], [1.01, 0, 0, 0], [0, 0, 0, 50.1], [0, np.nan, 0, 0], [0, 0, np.inf, 0]], float
    )
    assert cartpole.in_bounds(states).tolist() == [True, False, False, False, False]


def test_an_unknown_joint_is_rejected() -> None:
    model, _ = load_problem("cartpole").compile()
    with pytest.raises(UsageError, match="unknown joint 'hinje'. Did you mean 'hinge'"):
        StateSpace.from_model(model, ["slider", "hinje"])


MIXED = """<mujoco><compiler angle="radian"/><worldbody>
  <body><joint name="slide" type="slide" range="-1 2" limited="true"/><geom size="0.1"/>
    <body><joint name="ball" type="ball" range="0 2" limited="true"/><geom size="0.1"/></body></body>
  <body pos="0 0 3"><freejoint name="free"/><geom size="0.1"/></body>
</worldbody></mujoco>"""


@pytest.fixture
def mixed() -> StateSpace:
    """A slide, a limited ball and a free joint: 1 + 4 + 7 positions, 1 + 3 + 6 velocities."""
    bounds = {"free": ([-1.0, -2.0, 0.0], [1.0, 2.0, 3.0])}
    return StateSpace.from_model(load_model(MIXED), ["slide", "ball", "free"], position_bounds=bounds)


def test_balls_and_free_joints_are_read(mixed: StateSpace) -> None:
    assert (mixed.size, mixed.tangent_size) == (22, 20)
    assert mixed.quaternion_columns == (1, 8)
    assert mixed.names[:9] == (
        "slide", "ball_qw", "ball_qx", "ball_qy", "ball_qz", "free_x", "free_y", "free_z", "free_qw",
    )  # fmt: skip
    assert mixed.names[12:16] == ("slidevel", "ball_rxvel", "ball_ryvel", "ball_rzvel")
    assert len(mixed.units) == len(mixed.names) == 22
    assert mixed.bounded == ((0, 0), (5, 4), (6, 5), (7, 6))


def test_integrate_inverts_difference_and_agrees_with_mujoco(
    mixed: StateSpace, rng: np.random.Generator
) -> None:
    a, b = (mixed.sample(rng, 50, np.full(10, 2.0)) for _ in range(2))
    there = mixed.integrate(b, mixed.difference(a, b))
    np.testing.assert_allclose(mixed.difference(there, a), 0, atol=1e-10)
    np.testing.assert_allclose(np.linalg.norm(there[:, 1:5], axis=1), 1)
    # MuJoCo's own difference of positions, over one second
    model = load_model(MIXED)
    velocity = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, velocity, 1.0, b[0, :12], a[0, :12])
    np.testing.assert_allclose(mixed.difference(a[0], b[0])[:10], velocity, atol=1e-10)


def test_a_quaternion_and_its_negative_are_one_state(mixed: StateSpace, rng: np.random.Generator) -> None:
    x = mixed.sample(rng, 5, np.ones(10))
    y = x.copy()
    y[:, 1:5] *= -1
    np.testing.assert_allclose(mixed.distance(x, y), 0, atol=1e-12)
    weights = mixed.default_weights(np.ones(10))
    np.testing.assert_allclose(mixed.features(x, weights), mixed.features(y, weights))


def test_mirrored_features_find_rotations_of_the_other_sign(mixed: StateSpace) -> None:
    weights = np.ones(20)
    x = np.zeros((2, 22))
    x[:, 8] = 1.0
    # two rotations of about pi around x, one just below and one just above: 0.02 rad apart, but their
    # quaternions have opposite signs
    for row, angle in enumerate((np.pi - 0.01, np.pi + 0.01)):
        x[row, 1:3] = np.cos(angle / 2), np.sin(angle / 2)
    near, far = mixed.features(x, weights)
    assert np.linalg.norm(near - far) > 3.9  # 2 (q + q') is nearly 4 long
    best = min(np.linalg.norm(near - image) for image in mixed.mirrored(far))
    assert best == pytest.approx(0.02, rel=1e-3)


def test_interpolation_is_uniform_and_takes_the_short_way(
    mixed: StateSpace, rng: np.random.Generator
) -> None:
    a, b = mixed.sample(rng, 2, np.ones(10))
    path = mixed.interpolate(a, b, np.linspace(0, 1, 5))
    steps = mixed.difference(path[1:], path[:-1])
    np.testing.assert_allclose(steps, np.tile(steps[0], (4, 1)), atol=1e-10)
    np.testing.assert_allclose(mixed.difference(path[-1], b), 0, atol=1e-10)


def test_a_limited_ball_has_a_range(mixed: StateSpace) -> None:
    x = np.zeros((2, 22))
    x[:, 8] = 1.0
    for row, angle in enumerate((1.9, 2.1)):  # the range is 2 rad
        x[row, 1:3] = np.cos(angle / 2), np.sin(angle / 2)
    assert mixed.in_bounds(x).tolist() == [True, False]


def test_default_weights_scale_by_range(mixed: StateSpace) -> None:
    weights = mixed.default_weights(np.full(10, 4.0))
    np.testing.assert_allclose(weights[[0, 4, 5, 6]], [2 / 3, 1, 0.5, 2 / 3])  # 2 / range
    np.testing.assert_allclose(weights[[1, 2, 3, 7]], 1)  # rotations: 1 per radian
    np.testing.assert_allclose(weights[10:], 0.25)  # 1 / speed


def test_samples_are_within_bounds_and_uniform(mixed: StateSpace, rng: np.random.Generator) -> None:
    states = mixed.sample(rng, 2000, np.full(10, 2.0))
    balls = np.linalg.norm(mixed.difference(states, np.eye(22)[1] + np.eye(22)[8])[:, 1:4], axis=1)
    assert 0.3 < (balls < np.pi / 2).mean() * np.pi < 0.8  # uniform on SO(3): fraction (pi/2 - 1)/pi = 0.18
    inside = states[balls < 2]
    assert mixed.in_bounds(inside).all()


def test_a_kinematic_space_has_no_velocities() -> None:
    model = load_model(MIXED)
    space = StateSpace.from_model(model, ["slide", "ball"], kinematic=True)
    assert (space.size, space.tangent_size) == (5, 4)
    qpos, qvel, act = model.qpos0.copy(), np.ones(model.nv), np.empty(0)
    space.write(np.array([0.5, 0.0, 1.0, 0.0, 0.0]), qpos, qvel, act)
    assert qvel[:4].tolist() == [0, 0, 0, 0]
    np.testing.assert_array_equal(space.read(qpos, qvel, act), [0.5, 0.0, 1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"velocity_bound": [1.0, 2.0]}, "velocity_bound has 2 numbers; the joints have 10 velocities"),
        ({"position_bounds": {"fre": ([0.0], [1.0])}}, "Did you mean 'free'"),
        (
            {"position_bounds": {"free": ([0.0], [1.0])}},
            "a free joint takes 3 lower and 3 upper bounds, got 1 and 1",
        ),
        (
            {"position_bounds": {"ball": ([0.0], [1.0])}},
            "it is a ball joint, so it takes none; limit it in the",
        ),
    ],
)
def test_bounds_of_the_wrong_size_are_rejected(settings: dict, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        StateSpace.from_model(load_model(MIXED), ["slide", "ball", "free"], **settings)
