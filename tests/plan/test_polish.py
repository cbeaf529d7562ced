import numpy as np
import pytest

from planspace.physics.simulate import Simulator
from planspace.plan.polish import GoalRegulator, TailConfig, linearise
from planspace.plan.problem import load_problem

WEIGHTS = np.array([1.0, 1.0, 0.3, 0.1])


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    model, space = load_problem("cartpole-swingup").compile()
    return Simulator(model, space, 16, threads=1)


def test_linearise_predicts_small_steps(simulator: Simulator, rng: np.random.Generator) -> None:
    dynamics, actuation = linearise(simulator, np.zeros(4))
    states, controls = rng.uniform(-1e-3, 1e-3, (16, 4)), rng.uniform(-1e-3, 1e-3, (16, 1))
    simulator.reset(np.zeros((16, 4)))
    simulator.step(np.zeros((16, 1)))
    drift = simulator.states()[0]  # the pole's centre is 0.5 mm off its axis: zero is no exact equilibrium
    simulator.reset(states)
    simulator.step(controls)
    predicted = drift + states @ dynamics.T + controls @ actuation.T
    np.testing.assert_allclose(simulator.states(), predicted, atol=1e-7)
    assert np.abs(np.linalg.eigvals(dynamics)).max() > 1  # upright is unstable: there is something to do


def test_the_regulator_catches_a_tilted_pole_and_says_when_it_cannot(simulator: Simulator) -> None:
    regulator = GoalRegulator(simulator, np.zeros(4), WEIGHTS, TailConfig())
    starts = np.array([[0.1, 0.2, 0.0, 0.0], [0.0, np.pi, 0.0, 0.0], [0.0, 2 * np.pi + 0.1, 0.0, 0.0]])
    steps, arrived = regulator.steps_to_goal(simulator, starts, tolerance=0.1)
    assert arrived.tolist() == [True, False, True]  # hanging is too far; a winding does not matter
    assert 1 < steps[0] <= TailConfig().max_steps
    ends = simulator.states()[:3]
    assert simulator.space.distance(ends, np.zeros(4))[0] <= 0.1


def test_controls_stay_within_the_models_range(simulator: Simulator) -> None:
    regulator = GoalRegulator(simulator, np.zeros(4), WEIGHTS, TailConfig())
    far = np.array([[0.9, 1.0, 5.0, 9.0]])
    assert np.abs(regulator.control(far)).max() == 3.0
