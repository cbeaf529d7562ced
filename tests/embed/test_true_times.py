"""Distances beside shortest times: files that are read or refused, and measures worked out by hand."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.measurement import measure_embedding
from planspace.embed.true_times import (
    Truth,
    agreement,
    check_truth,
    compare_with_truth,
    load_truth,
    rank_correlation,
    scale_to_time,
)
from planspace.errors import PlanspaceError, UsageError

NAMES = ("slider", "hinge", "slidervel", "hingevel")
GOOD: dict[str, Any] = {
    "states": np.random.default_rng(0).normal(size=(9, 4)),
    "time": np.arange(9.0),
    "goals": np.random.default_rng(1).normal(size=(9, 4)),
    "on_plans": np.arange(9) < 4,
}
ONE_GOAL: dict[str, Any] = {"states": GOOD["states"], "time": GOOD["time"], "goal": np.zeros(4)}


def test_one_scale_is_calibrated_and_the_error_is_relative() -> None:
    distance, time = np.array([1.0, 2.0, 4.0, 5.0]), np.array([2.0, 4.0, 8.0, 0.0])
    scale = scale_to_time(distance, time)
    assert scale == pytest.approx(2.0)  # t / d is 2 in the three pairs with t > 0
    found = agreement(distance, time, 3.0)
    assert found.relative_error == pytest.approx(0.5)  # |3 d - t| / t = 1 / 2
    assert found.rank_correlation == pytest.approx(-0.2)  # ranks 1 2 3 4 and 2 3 4 1: 1 - 6 * 12 / 60
    assert found.predicted == (3.0, 6.0, 12.0, 15.0) and found.true == (2.0, 4.0, 8.0, 0.0)
    assert found.num_pairs == 4


def test_calibration_is_by_tenths_of_the_distance() -> None:
    distance = np.arange(20.0)[::-1]
    found = agreement(distance, 2 * distance, 2.0)
    assert found.predicted == found.true == tuple(2.0 * (2 * i + 0.5) for i in range(10))
    assert found.relative_error == 0.0 and found.rank_correlation == pytest.approx(1.0)


def test_constants_have_no_correlation_and_no_scale() -> None:
    assert rank_correlation(np.ones(3), np.arange(3.0)) == 0.0
    assert scale_to_time(np.zeros(3), np.arange(3.0)) == 0.0


def test_pairs_on_and_off_plans_are_measured_separately(embedding: Embedding, demos: Demos) -> None:
    truth = Truth(**GOOD)
    distance = embedding.distance(truth.states, truth.goals)
    time = np.where(GOOD["on_plans"], 0.5 * distance, -distance + distance.max() + 1.0)
    found = compare_with_truth(embedding, demos, np.arange(3), check_truth(truth._replace(time=time), NAMES))
    assert list(found) == ["all", "on_plans", "off_plans"]
    assert {name: found[name]["z"].num_pairs for name in found} == {"all": 9, "on_plans": 4, "off_plans": 5}
    assert found["on_plans"]["z"].rank_correlation == pytest.approx(1.0)
    assert found["off_plans"]["z"].rank_correlation == pytest.approx(-1.0)
    assert found["on_plans"]["z"].scale == found["off_plans"]["z"].scale


def test_the_raw_state_is_standardised_and_its_angles_wrap(embedding: Embedding, demos: Demos) -> None:
    states = np.zeros((3, 4))
    states[:, 1] = (2 * np.pi + 0.1, 0.2, -2 * np.pi + 0.3)
    truth = check_truth(Truth(states, np.array([1.0, 2.0, 3.0]), np.zeros(4)), NAMES)
    found = compare_with_truth(embedding, demos, np.arange(3), truth)["all"]["raw_state"]
    std = demos.states[demos.rows(np.arange(3))].std(axis=0)[1]
    assert found.scale == pytest.approx(10 * std)
    assert found.predicted == pytest.approx((1.0, 2.0, 3.0))


def test_the_embeddings_own_time_is_measured_without_a_scale(
    embedding: Embedding, demos: Demos, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: Any) -> np.ndarray:
        raise PlanspaceError("the embedding has no time head")

    def estimated(_: Embedding, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return 3.0 * np.abs(a - b)[:, 0]

    time = 4.0 * np.abs(GOOD["states"] - GOOD["goals"])[:, 0]
    truth = check_truth(Truth(GOOD["states"], time, GOOD["goals"]), NAMES)
    monkeypatch.setattr(Embedding, "time_to_go", estimated, raising=False)
    found = compare_with_truth(embedding, demos, np.arange(3), truth)["all"]["time_to_go"]
    assert found.scale == 1.0 and found.relative_error == pytest.approx(0.25)
    monkeypatch.setattr(Embedding, "time_to_go", refused, raising=False)
    assert "time_to_go" not in compare_with_truth(embedding, demos, np.arange(3), truth)["all"]


def test_files_of_pairs_and_of_one_goal_are_measured(
    embedding: Embedding, demos: Demos, tmp_path: Path
) -> None:
    np.savez(tmp_path / "pairs.npz", **GOOD, other=np.zeros(2))
    found = measure_embedding(embedding, demos, truth=tmp_path / "pairs.npz")
    assert set(found.to_dict()["true_times"]["on_plans"]) == {"z", "raw_state"}
    assert "true time, on plans" in repr(found)
    same = measure_embedding(embedding, demos, truth=Truth(**GOOD)).to_dict()
    assert same == found.to_dict()
    np.savez(tmp_path / "one.npz", **ONE_GOAL)
    assert load_truth(tmp_path / "one.npz", NAMES).goals.shape == (9, 4)
    one = measure_embedding(embedding, demos, truth=tmp_path / "one.npz").to_dict()
    assert list(one["true_times"]) == ["all"]
    assert one["checks"]["true_time_correlation"] == one["true_times"]["all"]["z"]["rank_correlation"]


@pytest.mark.parametrize(
    ("message", "arrays"),
    [
        ("`states` must be", ONE_GOAL | {"states": np.zeros((9, 3))}),
        (
            r"`goals` \[n, 4\] or `goal` \[4\]; got \(9, 4\), \(9,\) and \(8, 4\)",
            GOOD | {"goals": np.ones((8, 4))},
        ),
        ("not finite", ONE_GOAL | {"time": np.full(9, np.nan)}),
        ("not finite", GOOD | {"goals": np.full((9, 4), np.inf)}),
        ("with `states`, `time` and `goals` or `goal`", {"states": GOOD["states"]}),
        ("two different times", ONE_GOAL | {"time": np.ones(9)}),
        ("must not be negative, got -3", ONE_GOAL | {"time": np.arange(-3.0, 6.0)}),
        (r"got \(9, 4\), \(\)", ONE_GOAL | {"time": np.array(1.0)}),
        (r"`on_plans` must be 9 truth values \(bool\), got float64 \(9,\)", GOOD | {"on_plans": np.ones(9)}),
        (r"`on_plans` must be 9 .*, got bool \(3,\)", GOOD | {"on_plans": np.ones(3, dtype=bool)}),
    ],
)
def test_invalid_files_are_rejected(message: str, arrays: dict[str, Any], tmp_path: Path) -> None:
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(PlanspaceError, match=message):
        load_truth(tmp_path / "bad.npz", NAMES)


def test_an_invalid_object_is_rejected(embedding: Embedding, demos: Demos) -> None:
    with pytest.raises(UsageError, match="two different times"):
        measure_embedding(embedding, demos, truth=Truth(GOOD["states"], np.ones(9), np.zeros(4)))


def test_single_arrays_and_truncated_files_are_rejected(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("no")
    np.save(tmp_path / "a.npy", np.zeros(3))
    np.savez(tmp_path / "b.npz", states=np.zeros((900, 4)))
    (tmp_path / "b.npz").write_bytes((tmp_path / "b.npz").read_bytes()[:-200])
    for name in ("text.npz", "a.npy", "b.npz"):
        with pytest.raises(PlanspaceError, match="is not an .npz with"):
            load_truth(tmp_path / name, NAMES)
