"""Knots become controls as interpolation says."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from planspace.control.controller import colored
from planspace.control.splines import SplineOrder, spline_matrix

KNOTS = np.array([0.0, 1.0, -1.0, 0.5])
TIMES = np.linspace(0.0, 0.9, 13)


@pytest.mark.parametrize("order", ["zero", "linear", "cubic"])
def test_constant_knots_are_constant_controls(order: SplineOrder) -> None:
    matrix = spline_matrix(TIMES, 0.9, 4, order)
    np.testing.assert_allclose(matrix @ np.ones(4), 1.0, atol=1e-12)


@pytest.mark.parametrize("order", ["zero", "linear", "cubic"])
def test_after_the_last_knot_its_value_holds(order: SplineOrder) -> None:
    assert (spline_matrix(np.array([0.9, 1.5]), 0.9, 4, order) @ KNOTS).tolist() == [0.5, 0.5]


def test_linear_and_cubic_splines_are_those_of_numpy_and_scipy() -> None:
    at = np.linspace(0.0, 0.9, 4)
    linear, cubic = (spline_matrix(TIMES, 0.9, 4, order) @ KNOTS for order in ("linear", "cubic"))
    np.testing.assert_allclose(linear, np.interp(TIMES, at, KNOTS), atol=1e-12)
    np.testing.assert_allclose(cubic, CubicSpline(at, KNOTS, bc_type="natural")(TIMES), atol=1e-12)


def test_a_held_knot_lasts_until_the_next() -> None:
    held = spline_matrix(np.array([0.0, 0.29, 0.3, 0.59, 0.6]), 0.9, 4, "zero") @ KNOTS
    assert held.tolist() == [0.0, 0.0, 1.0, 1.0, -1.0]


def test_a_single_knot_is_held() -> None:
    assert (spline_matrix(TIMES, 0.9, 1, "linear") @ np.array([0.7]) == 0.7).all()


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("num_knots", [4, 7])
def test_colored_noise_has_variance_one_and_neighbours_that_agree(
    exponent: float, num_knots: int, rng: np.random.Generator
) -> None:
    noise = colored(rng.standard_normal((20_000, num_knots, 2)), exponent)
    np.testing.assert_allclose(noise.var(axis=0), 1.0, atol=0.05)
    assert (noise[:, 1:] * noise[:, :-1]).mean() > 0.05
