import numpy as np
import pytest

from planspace.physics.simulator import Simulator
from planspace.plan.config import RegulatorConfig
from planspace.plan.regulator import Regulator
from planspace.tasks.problem import Goal
from planspace.tasks.problem_file import load_problem

WEIGHTS = np.array([1.0, 1.0, 0.3, 0.1])


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    model, space = load_problem("cartpole-swingup").compile()
    return Simulator(model, space, 16, threads=1)


@pytest.fixture(scope="module")
def regulator(simulator: Simulator) -> Regulator:
    goal = Goal(simulator.space, np.zeros(4), np.zeros(4), np.ones(4), 0.1)
    return Regulator(simulator, goal, WEIGHTS, RegulatorConfig())


def test_catches_a_tilted_pole_and_reports_when_it_cannot(simulator: Simulator, regulator: Regulator) -> None:
    starts = np.array([[0.1, 0.2, 0.0, 0.0], [0.0, np.pi, 0.0, 0.0], [0.0, 2 * np.pi + 0.1, 0.0, 0.0]])
    controls, steps, arrived = regulator.finish(simulator, starts)
    assert arrived.tolist() == [
        True,
        False,
        True,
    ]  # the hanging pole is too far away; a full turn does not matter
    assert 1 < steps[0] <= RegulatorConfig().max_s / simulator.model.opt.timestep
    # the returned controls lead to the goal
    simulator.reset(starts[:1], np.array([0], dtype=np.int32))
    for control in controls[0, : steps[0]]:
        simulator.step(control[None], ids=np.array([0], dtype=np.int32))
    assert regulator.goal.reached(simulator.states()[:1]).all()


def test_controls_stay_within_the_models_range(regulator: Regulator) -> None:
    assert np.abs(regulator.control(np.array([[0.9, 1.0, 5.0, 9.0]]))).max() == 3.0


def test_a_direction_without_weight_and_control_is_ignored() -> None:
    """No motor rotates a rod about its own axis: the plain Riccati equation has no solution."""
    problem = load_problem("ball-pendulum")
    model, space = problem.compile()
    simulator = Simulator(model, space, 32, threads=1)
    goal = problem.draw_goal(space, np.random.default_rng(0))
    regulator = Regulator(simulator, goal, problem.weights(space), RegulatorConfig(max_s=3.0))
    tilted = space.integrate(goal.center, np.array([0.1, -0.1, 0.5, 0.0, 0.0, 0.0]))
    assert goal.distance(tilted) == pytest.approx(0.2)  # the rotation of 0.5 rad has weight 0
    *_, arrived = regulator.finish(simulator, tilted[None])
    assert arrived.all()


def test_a_goal_that_cannot_be_stabilised_has_zero_gain() -> None:
    problem = load_problem("cartpole-swingup")
    model, space = problem.compile()
    model.actuator_gear[:] = 0.0  # no control has an effect
    simulator = Simulator(model, space, 32, threads=1)
    goal = Goal(space, np.zeros(4), np.zeros(4), np.ones(4), 0.1)
    regulator = Regulator(simulator, goal, WEIGHTS, RegulatorConfig())
    assert not regulator.gain.any()
    near, far = np.array([[0.0, 0.1, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0, 0.0]])
    assert regulator.cost_to_go(near) < regulator.cost_to_go(far)


def test_an_ill_conditioned_riccati_equation_has_no_gain(
    simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SciPy raises a plain ValueError for it, as on a hopper whose foot touches the floor."""

    def fail(*_: object) -> None:
        raise ValueError("the problem is very ill-conditioned")

    monkeypatch.setattr("scipy.linalg.solve_discrete_are", fail)
    goal = Goal(simulator.space, np.zeros(4), np.zeros(4), np.ones(4), 0.1)
    assert not Regulator(simulator, goal, WEIGHTS, RegulatorConfig()).gain.any()
