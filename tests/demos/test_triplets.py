import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.demos.triplets import random_triplets, triplet_rows
from planspace.errors import PlanspaceError

INFO = StateInfo(("x",), ("m",), (), 1)


def of_lengths(*lengths: int) -> Demos:
    return Demos.from_episodes(
        INFO,
        [
            Episode(np.zeros((n, 1)), np.zeros((n - 1, 1)), np.arange(n) * 1.0, np.zeros(1), True, i, 0)
            for i, n in enumerate(lengths)
        ],
    )


def test_all_triplets_of_two_short_demonstrations() -> None:
    # rows 0-3 and 4-8; spacing 1 fits (0 1 2) (1 2 3) and (4 5 6) (5 6 7) (6 7 8); spacing 2 fits (4 6 8)
    rows = triplet_rows(of_lengths(4, 5), np.array([0, 1]), (1, 2))
    assert sorted(map(tuple, rows.tolist())) == sorted(
        [(0, 1, 2), (1, 2, 3), (4, 5, 6), (5, 6, 7), (6, 7, 8), (4, 6, 8)]
    )


def test_triplets_stay_within_one_demonstration(demos: Demos) -> None:
    rows = triplet_rows(demos, np.arange(len(demos)), (1, 3, 5, 10, 30))
    owner = np.searchsorted(demos.offsets, rows, side="right")
    assert (owner == owner[:, :1]).all()


def test_only_the_given_demonstrations_are_used() -> None:
    rows = triplet_rows(of_lengths(4, 5), np.array([1]), (1,))
    assert rows.min() == 4


def test_demonstrations_that_are_too_short_are_refused() -> None:
    with pytest.raises(PlanspaceError, match="the longest demonstration has 4 states, too few"):
        triplet_rows(of_lengths(4, 3), np.array([0, 1]), (3, 5))


def test_random_triplets_have_uniform_middles_and_ends() -> None:
    rng = np.random.default_rng(0)
    rows = random_triplets(of_lengths(2, 5, 4), np.array([0, 1, 2]), 30_000, rng)
    # inner rows: none of the first demonstration (rows 0-1), 3 of the second (2-6), 2 of the third (7-10)
    middle, counts = np.unique(rows[:, 1], return_counts=True)
    assert middle.tolist() == [3, 4, 5, 8, 9]
    np.testing.assert_allclose(counts / 30_000, 0.2, atol=0.02)
    assert (rows[:, 0] < rows[:, 1]).all() and (rows[:, 1] < rows[:, 2]).all()
    # around row 4, two states before (2, 3) and two after (5, 6): four equally likely triplets
    around, counts = np.unique(rows[rows[:, 1] == 4], axis=0, return_counts=True)
    assert around.tolist() == [[2, 4, 5], [2, 4, 6], [3, 4, 5], [3, 4, 6]]
    np.testing.assert_allclose(counts / counts.sum(), 0.25, atol=0.03)


def test_short_triplets_are_more_frequent_with_short_fraction() -> None:
    demos, length = of_lengths(1001), 1000
    spans = {}
    for short_fraction in (0.0, 0.5, 1.0):
        rows = random_triplets(demos, np.array([0]), 40_000, np.random.default_rng(0), short_fraction)
        a, t, b = rows.T
        assert ((a >= 0) & (a < t) & (t < b) & (b <= length)).all()
        spans[short_fraction] = b - a
    assert np.median(spans[1.0]) < 0.2 * np.median(spans[0.0])
    assert (spans[1.0] < 10).mean() > 0.15 > 0.01 > (spans[0.0] < 10).mean()
    assert (spans[1.0] > 500).mean() > 0.01
    short = [(spans[short_fraction] < 10).mean() for short_fraction in (0.0, 0.5, 1.0)]
    assert short[1] == pytest.approx((short[0] + short[2]) / 2, abs=0.02)


def test_random_triplets_need_three_states() -> None:
    with pytest.raises(PlanspaceError, match="no demonstration has the 3 states"):
        random_triplets(of_lengths(2, 2), np.array([0, 1]), 10, np.random.default_rng(0))
