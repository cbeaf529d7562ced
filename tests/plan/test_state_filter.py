"""The extended Kalman filter of estimated states."""

import numpy as np
import pytest

from planspace.control.plant import Plant
from planspace.plan.state_filter import StateFilter

NOISE = {
    "cartpole-swingup": (0.03, 0.05, 0.4, 1.2),
    "ball-pendulum": (0.05, 0.05, 0.05, 0.05, 0.5, 0.5, 0.5),
}
"""Errors of the estimates of a state."""


def filter_of(plant: Plant, noise: np.ndarray) -> StateFilter:
    return StateFilter(plant.model, plant.space, plant.physics_steps, noise)


def errors_of(plant: Plant, noise: np.ndarray, num_steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of estimates and of filtered estimates along a motion with random controls [step, tangent]."""
    rng, simulator, space = np.random.default_rng(0), plant.simulator(1), plant.space
    state, filtered = filter_of(plant, noise), []
    now, control = plant.task.sample_starts(1, rng)[0], np.zeros(plant.model.nu)
    simulator.reset(now)
    for step in range(num_steps):
        estimate = space.normalise(now[0] + noise * rng.standard_normal(space.size))
        found = state(estimate)
        filtered.append((space.difference(estimate, now[0]), space.difference(found, now[0])))
        if step % 5 == 0:
            control = rng.uniform(simulator.control_low, simulator.control_high)
        state.predict(control)
        simulator.step(control[None], plant.task.frame_skip)
        now = simulator.states()
    estimates, found = np.array(filtered).transpose(1, 0, 2)
    return estimates, found


@pytest.mark.parametrize("name", NOISE)
def test_the_filter_halves_the_errors_or_better(name: str) -> None:
    estimates, filtered = errors_of(Plant.find(name), np.array(NOISE[name]), num_steps=120)
    np.testing.assert_array_equal(filtered[0], estimates[0])  # nothing is known before the first estimate
    before, after = (np.sqrt((errors[20:] ** 2).mean(axis=0)) for errors in (estimates, filtered))
    assert (after < 0.6 * before).all()
    velocities = Plant.find(name).space.tangent_velocities
    assert (after[velocities] < 0.4 * before[velocities]).all()


def test_exact_estimates_stay_exact() -> None:
    estimates, filtered = errors_of(Plant.find("cartpole-swingup"), np.full(4, 1e-9), num_steps=30)
    assert np.abs(filtered).max() < 1e-7
    assert np.abs(estimates).max() < 1e-7


def test_one_step_is_the_textbook_one() -> None:
    """For one scalar of a diagonal problem: variance p before, r of the estimate, gain p / (p + r)."""
    plant, errors = Plant.find("cartpole-swingup"), np.array(NOISE["cartpole-swingup"])
    state = filter_of(plant, errors)
    first, second = np.zeros(4), np.array([0.1, 0.2, 0.3, 0.4])
    state(first)
    np.testing.assert_allclose(state(second), second / 2, rtol=1e-12)  # equal variances
    np.testing.assert_allclose(state(np.zeros(4)), second / 3, rtol=1e-12)


def test_a_control_beyond_its_limits_acts_like_the_limit() -> None:
    plant = Plant.find("cartpole-swingup")
    high = plant.simulator(1).control_high
    found = []
    for control in (high, 100 * high):
        state = filter_of(plant, np.full(4, 1e-3))
        state(np.zeros(4))
        state.predict(control)
        found.append(state(np.zeros(4)))
    np.testing.assert_array_equal(*found)
