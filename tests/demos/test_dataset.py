import numpy as np
import pytest

from planspace.demos.dataset import Demos, Episode, StateInfo
from planspace.demos.describe import replay_errors
from planspace.errors import PlanspaceError

INFO = StateInfo(("x", "v"), ("m", "m/s"), (), 1)


def episode(index: int, length: int = 5) -> Episode:
    states = np.arange(2.0 * length).reshape(length, 2) + index
    return Episode(
        states, np.ones((length - 1, 1)), np.arange(length) * 0.1, np.zeros(2), True, index, seed=0
    )


def test_planned_demos_end_at_the_goal_and_replay(demos: Demos) -> None:
    ends = demos.states[demos.offsets[1:] - 1]
    assert (np.abs(ends).sum(axis=1) <= 0.1).all()  # stored angles end in (-pi, pi]: no wrapping needed
    assert replay_errors(demos).max() <= 1e-6


def test_split_is_by_demo_seeded_and_complete(demos: Demos) -> None:
    split = demos.split(0)
    together = np.concatenate(list(split.values()))
    assert sorted(together) == list(range(len(demos)))
    assert [len(part) for part in split.values()] == [10, 1, 1]
    assert all((a == b).all() for a, b in zip(split.values(), demos.split(0).values(), strict=True))
    assert any((a != b).any() for a, b in zip(split.values(), demos.split(1).values(), strict=True))
    with pytest.raises(PlanspaceError, match="2 demonstrations cannot be split in three"):
        Demos.from_episodes(INFO, [episode(0), episode(1)]).split(0)
