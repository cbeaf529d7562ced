import numpy as np
import pytest

from planspace.plan import polish_repair


def test_a_program_of_many_iterations_goes_to_the_interior_point_method(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, cost = rng.normal(size=(40, 120)), rng.uniform(size=120)
    program = {"A_eq": rows, "b_eq": rows @ rng.uniform(size=120), "bounds": (0.0, 1.0)}
    by_simplex = polish_repair.minimum(cost, **program)
    monkeypatch.setattr(polish_repair, "MAX_PIVOTS", 30)  # it took 90
    otherwise = polish_repair.minimum(cost, **program)
    assert by_simplex is not None and otherwise is not None
    assert cost @ otherwise == pytest.approx(cost @ by_simplex, abs=1e-9)
    monkeypatch.setattr(polish_repair, "MAX_PIVOTS", 5)
    assert polish_repair.minimum(cost, **program) is None


def test_a_program_without_solution_has_no_minimum() -> None:
    assert polish_repair.minimum(np.ones(2), A_eq=np.ones((1, 2)), b_eq=[3.0], bounds=(0.0, 1.0)) is None
