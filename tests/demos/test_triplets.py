import numpy as np
import pytest

from planspace.demos.dataset import Demos, Episode, StateInfo
from planspace.demos.triplets import triplet_rows
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


def test_every_triplet_of_two_short_demos() -> None:
    # rows 0-3 and 4-8; spacing 1 fits (0 1 2) (1 2 3) and (4 5 6) (5 6 7) (6 7 8); spacing 2 fits (4 6 8)
    rows = triplet_rows(of_lengths(4, 5), np.array([0, 1]), (1, 2))
    assert sorted(map(tuple, rows.tolist())) == sorted(
        [(0, 1, 2), (1, 2, 3), (4, 5, 6), (5, 6, 7), (6, 7, 8), (4, 6, 8)]
    )


def test_no_triplet_crosses_from_one_demo_to_the_next(demos: Demos) -> None:
    rows = triplet_rows(demos, np.arange(len(demos)))
    owner = np.searchsorted(demos.offsets, rows, side="right")
    assert (owner == owner[:, :1]).all()


def test_only_the_given_demos_are_cut() -> None:
    rows = triplet_rows(of_lengths(4, 5), np.array([1]), (1,))
    assert rows.min() == 4


def test_too_short_demos_are_refused() -> None:
    with pytest.raises(PlanspaceError, match="the longest demonstration has 4 states, too short"):
        triplet_rows(of_lengths(4, 3), np.array([0, 1]), (3, 5))
