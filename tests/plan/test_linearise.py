import numpy as np
import pytest

from planspace.physics.simulator import Simulator
from planspace.plan import linearise
from planspace.tasks.problem_file import load_problem


def make(name: str, num: int = 16) -> Simulator:
    problem = load_problem(name)
    model, space = problem.compile()
    return Simulator(model, space, num, threads=1, validity=problem.validity)


@pytest.mark.parametrize("name", ["cartpole-swingup", "ball-pendulum", "quadrotor", "arm-kinematic"])
def test_the_linear_model_predicts_small_changes(name: str, rng: np.random.Generator) -> None:
    problem, simulator = load_problem(name), make(name)
    space, count = simulator.space, 10
    low, high = simulator.control_low, simulator.control_high
    states = space.sample(rng, count, np.full(space.num_dofs, 0.5))
    controls = rng.uniform(0.8 * low + 0.2 * high, 0.2 * low + 0.8 * high, (count, len(low)))
    a, b = linearise.along(simulator, states, controls)
    dx, du = rng.normal(0, 1e-4, (count, space.tangent_size)), rng.normal(0, 1e-4, controls.shape)
    ids = np.arange(count, dtype=np.int32)
    ends = []
    for x, u in ((states, controls), (space.integrate(states, dx), controls + du)):
        simulator.reset(x, ids)
        simulator.step(u, ids=ids)
        ends.append(simulator.states()[:count])
    predicted = np.einsum("kij,kj->ki", a, dx) + np.einsum("kij,kj->ki", b, du)
    np.testing.assert_allclose(space.difference(ends[1], ends[0]), predicted, atol=2e-6)
    assert np.abs(predicted).max() > 1e-4, problem.name


def test_at_a_limit_the_control_is_only_moved_inwards(rng: np.random.Generator) -> None:
    simulator = make("cartpole-swingup")
    states = rng.uniform(-0.1, 0.1, (3, 4))
    _, inner = linearise.along(simulator, states, np.full((3, 1), 2.9))
    _, bound = linearise.along(simulator, states, np.full((3, 1), 3.0))  # MuJoCo would clip a larger control
    np.testing.assert_allclose(bound, inner, rtol=1e-4)


def test_sensitivities_are_products_of_the_step_matrices(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(3, 2, 2)), rng.normal(size=(3, 2, 1))
    answer = linearise.sensitivities(a, b)
    # x_3 = A_2 A_1 B_0 u_0 + A_2 B_1 u_1 + B_2 u_2
    expected = np.hstack([a[2] @ a[1] @ b[0], a[2] @ b[1], b[2]])
    np.testing.assert_allclose(answer[3], expected)
    np.testing.assert_array_equal(answer[0], 0)
    np.testing.assert_array_equal(answer[1][:, 1:], 0)  # later controls have no effect


def test_a_time_varying_regulator_stabilises_an_unstable_system() -> None:
    a, b = np.full((40, 1, 1), 1.5), np.ones((40, 1, 1))  # x grows by a factor of 1.5 per step
    gains = linearise.time_varying_lqr(a, b, np.ones(1), np.full(1, 0.01))[0]
    x = 1.0
    for k in range(40):
        x = 1.5 * x - float(gains[k, 0, 0]) * x
    assert abs(x) < 1e-6


def test_a_step_whose_linear_model_overflows_has_no_gain_and_the_others_have_theirs() -> None:
    a, b = np.full((40, 1, 1), 1.5), np.ones((40, 1, 1))
    known = linearise.time_varying_lqr(a, b, np.ones(1), np.full(1, 0.01))[0]
    a[20] = np.inf
    gains = linearise.time_varying_lqr(a, b, np.ones(1), np.full(1, 0.01))[0]
    assert gains[20] == 0
    np.testing.assert_array_equal(gains[21:], known[21:])
    np.testing.assert_allclose(gains[:10], known[:10], rtol=1e-6)


def test_the_equilibrium_control_of_a_quadrotor_is_its_weight() -> None:
    simulator = make("quadrotor")
    level = np.zeros(13)
    level[3] = 1.0
    control = linearise.equilibrium_control(simulator, level)
    np.testing.assert_allclose(control, 0.5 * 9.81 / 4, rtol=1e-6)  # a quarter of m g for each rotor
