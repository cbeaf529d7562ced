"""iLQR finds the controls that a search over all controls finds, and refuses costs that it cannot use."""

from itertools import product

import numpy as np
import pytest

from planspace import Controller, Embedding, UsageError
from planspace.control.config import ControlConfig

STATE = np.array([0.1, 0.3, 0.0, -0.5])
GRID = np.linspace(-3.0, 3.0, 9)
"""Controls of the cart-pole [N]."""


def controller(embedding: Embedding, **settings: object) -> Controller:
    config = ControlConfig(cost="raw", horizon_s=0.12, regulator=False, **settings)  # pyright: ignore
    return Controller("cartpole-swingup", embedding, config, threads=1)


def test_it_finds_the_best_controls(embedding: Embedding) -> None:
    grid = np.array(list(product(GRID, repeat=3)))[:, :, None]  # three control steps
    every = controller(embedding, samples=len(grid))
    least = every._simulate(STATE, lambda step, _: grid[:, step], len(grid))[2].min()
    refining = controller(embedding, samples=4, ilqr_rounds=1)
    controls, costs = np.zeros((3, 1)), []
    for _ in range(20):
        costs.append(refining._simulate(STATE, lambda step, _, u=controls: u[None, step], 1)[2][0])
        controls = refining._refined(STATE, controls)
    assert (np.diff(costs) <= 0).all() and least < costs[0]
    assert costs[-1] <= least + 0.02 * (costs[0] - least)
    assert np.abs(controls).max() <= 3.0


def test_a_controller_acts_by_the_refined_controls_and_knows_their_knots(embedding: Embedding) -> None:
    plain, refining = (controller(embedding, samples=4, ilqr_rounds=n) for n in (0, 1))
    assert plain(STATE) != refining(STATE)
    knots = refining._knots @ refining._spline
    np.testing.assert_allclose(refining._spline @ knots, refining._spline, atol=1e-12)


def test_controls_that_cost_nothing_are_kept(embedding: Embedding) -> None:
    config = ControlConfig(cost="raw", horizon_s=0.12, samples=4, ilqr_rounds=1, effort_weight=0.0)
    flat = Controller("cartpole-swingup", embedding, config, threads=1)
    flat._cost.distance = lambda states: np.ones(states.shape[:-1])  # pyright: ignore
    controls = np.array([[0.5], [-1.0], [2.0]])
    np.testing.assert_allclose(flat._refined(STATE, controls), controls)


def test_it_needs_a_distance() -> None:
    with pytest.raises(UsageError, match="ilqr_rounds needs a cost that is a distance: z, time or raw"):
        ControlConfig(cost="reward", ilqr_rounds=1)
    with pytest.raises(UsageError, match="ilqr_rounds` must be at least 0, got -1"):
        ControlConfig(ilqr_rounds=-1)
