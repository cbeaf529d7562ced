import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.support import Support
from planspace.errors import PlanspaceError


def test_states_inside_and_outside_of_a_square(rng: np.random.Generator) -> None:
    points = rng.uniform(-1, 1, (4000, 2)) * [1.0, 100.0]  # units must not matter
    support = Support.fit(points[:3000], points[3000:], rng)
    inside = rng.uniform(-0.9, 0.9, (500, 2)) * [1.0, 100.0]
    assert support.outside(inside).mean() < 0.02
    assert support.outside(np.array([[1.5, 0.0], [0.0, 150.0], [-1.4, -140.0]])).all()


def test_the_distance_to_the_nearest_point_decides() -> None:
    support = Support(np.array([[0.0, 0.0], [4.0, 0.0]], np.float32), np.array([1.0, 2.0]), 1.0)
    # over the scale (1, 2): (0, 2) is 1 away from the first, (4, 2.2) is 1.1 away from the second
    assert support.outside(np.array([[0.0, 1.98], [4.0, 2.2]])).tolist() == [False, True]


def test_demonstrations_are_inside_and_distant_states_outside(embedding: Embedding, demos: Demos) -> None:
    assert embedding.outside_support(demos.states).mean() < 0.2
    far = demos.states * [5.0, 1.0, 5.0, 5.0] + [3.0, 0.0, 20.0, 40.0]
    assert embedding.outside_support(far).all()
    with pytest.raises(PlanspaceError, match="not finite"):
        embedding.outside_support(np.full((1, 4), np.nan))


def test_states_may_have_any_leading_axes(embedding: Embedding, demos: Demos) -> None:
    states = demos.states[:6].reshape(2, 3, 4)
    many = embedding.outside_support(states)
    assert many.shape == (2, 3)
    assert many[1, 2] == embedding.outside_support(states[1, 2])
    with pytest.raises(PlanspaceError, match="reads states of 4 numbers"):
        embedding.outside_support(np.zeros((2, 3)))


def test_states_far_from_zero_are_compared_accurately(rng: np.random.Generator) -> None:
    far = 1e6 + rng.normal(size=(1000, 2))
    support = Support.fit(far[:800], far[800:], rng)
    assert support.outside(far).mean() < 0.02
    assert support.outside(np.array([[1e6 + 6.0, 1e6]])).all()
