"""Methods move the mean to where costs are low."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from planspace.control.config import ControlConfig
from planspace.control.method import Method, improved
from planspace.control.methods import METHODS
from planspace.control.methods.cem import CEM
from planspace.control.methods.mppi import MPPI
from planspace.errors import UsageError

TARGET = np.array([[0.3], [-0.4]])


def candidates(rng: np.random.Generator, mean: np.ndarray, std: np.ndarray, num: int = 200) -> np.ndarray:
    noise = rng.standard_normal((num, *mean.shape))
    noise[0] = 0.0
    return mean + std * noise


def quadratic(knots: np.ndarray) -> np.ndarray:
    return ((knots - TARGET) ** 2).sum(axis=(1, 2))


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_a_quadratic_cost_is_minimised_in_some_rounds(method: Method, rng: np.random.Generator) -> None:
    mean, std = np.zeros((2, 1)), np.full((2, 1), 0.5)
    for _ in range(20):
        found = candidates(rng, mean, std)
        mean, std = method.improve(std, found, quadratic(found))
    assert np.abs(mean - TARGET).max() < 0.1


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_a_candidate_that_diverged_has_no_part(method: Method, rng: np.random.Generator) -> None:
    std = np.full((2, 1), 0.5)
    found = candidates(rng, np.zeros((2, 1)), std)
    costs = np.where(np.arange(200) < 20, quadratic(found), np.inf)
    mean, _ = method.improve(std, found, costs)
    few, _ = method.improve(std, found[:20], costs[:20])
    if method.name != "cem":  # whose elite is a fraction of all candidates # pyright: ignore
        np.testing.assert_allclose(mean, few)
    assert np.isfinite(mean).all()


def test_mppi_without_any_finite_cost_keeps_its_mean(rng: np.random.Generator) -> None:
    found = candidates(rng, np.ones((2, 1)), np.ones((2, 1)))
    assert (MPPI().improve(np.ones((2, 1)), found, np.full(200, np.inf))[0] == 1.0).all()


def test_a_cold_mppi_takes_the_best_candidate(rng: np.random.Generator) -> None:
    found = candidates(rng, np.zeros((2, 1)), np.ones((2, 1)))
    costs = quadratic(found)
    mean, _ = MPPI(temperature=1e-6).improve(np.ones((2, 1)), found, costs)
    np.testing.assert_allclose(mean, found[costs.argmin()])


def test_cem_narrows_down_to_its_least_deviation(rng: np.random.Generator) -> None:
    same = np.zeros((100, 2, 1))
    _, std = CEM(min_std=0.2).improve(np.ones((2, 1)), same, np.zeros(100))
    assert (std == 0.2).all()


@pytest.mark.parametrize(
    ("method", "value", "says"),
    [(MPPI, {"temperature": 0.0}, "temperature"), (CEM, {"elite_fraction": 1.5}, "elite_fraction")],
)
def test_settings_out_of_range_are_refused(method: type, value: dict[str, float], says: str) -> None:
    with pytest.raises(UsageError, match=f"`{says}` must be"):
        method(**value)


@dataclass(frozen=True)
class Returns:
    """A method that returns what it is told to."""

    found: Any
    iterations: Any = 1

    def improve(self, std: np.ndarray, candidates: np.ndarray, costs: np.ndarray) -> Any:
        return self.found


GOOD = np.zeros((2, 1))


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (GOOD, r"must return a mean and a standard deviation, got array"),
        ((GOOD, GOOD, GOOD), "must return a mean and a standard deviation"),
        ((np.zeros(2), GOOD), r"a mean of shape \(2, 1\), got shape \(2,\)"),
        ((GOOD, np.zeros((2, 3))), r"a std of shape \(2, 1\), got shape \(2, 3\)"),
        (("much", GOOD), r"a mean of shape \(2, 1\), got 'much'"),
        ((np.full((2, 1), np.nan), GOOD), "a finite mean, got nan"),
        ((GOOD, np.full((2, 1), -0.5)), "at least 0, got -0.5"),
    ],
)
def test_what_a_method_returns_is_checked(found: Any, message: str, rng: np.random.Generator) -> None:
    std = np.ones((2, 1))
    with pytest.raises(UsageError, match=f"Method .*Returns: improve.*{message}.*own-method.md"):
        improved(Returns(found), std, candidates(rng, GOOD, std), np.zeros(200))
    assert (
        improved(Returns(([[0.0], [1.0]], std)), std, candidates(rng, GOOD, std), np.zeros(200))[0][1] == 1.0
    )


@pytest.mark.parametrize("iterations", [0, 1.5, "2"])
def test_the_rounds_of_a_method_are_a_number(iterations: Any) -> None:
    with pytest.raises(UsageError, match="iterations.*whole number of at least 1"):
        ControlConfig(method=Returns((GOOD, GOOD), iterations))


@pytest.mark.parametrize("name", ["horizon_s", "noise", "terminal_weight", "follow_s"])
def test_settings_are_finite(name: str) -> None:
    with pytest.raises(UsageError, match=f"{name}.*finite.*inf"):
        replace(ControlConfig(), **{name: float("inf")})
