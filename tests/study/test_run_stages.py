"""Parts of `planspace run`: the interval of its number, its control stage, and its policies."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.control.config import ControlConfig
from planspace.embed.saved_embedding import load_embedding
from planspace.study import run_control
from planspace.study.budgets import BUDGETS, Budget, ControlBudget
from planspace.study.paired import success_difference
from planspace.study.quickstart_report import shipped_bands
from planspace.study.run_control import find_plant, usable_horizons
from planspace.study.run_policies import run_arms, verdicts
from planspace.tasks.catalog import find_task

STUDY = Path(__file__).parents[2] / "results" / "study" / "controls-half" / "results.csv"
GOLDEN = Path(__file__).parents[1] / "golden" / "2026-11" / "embedding"
STEPS = np.arange(1, 11) * 4000


def test_the_interval_of_a_difference_where_everything_succeeds_or_fails() -> None:
    # Wilson: the lower end at 10 of 10 is 10 / (10 + 1.96^2) = 0.7225, the upper end at 0 of 10 is 0.2775.
    # Without variation phi is 0, so the interval is 1 - sqrt(0.2775^2 + 0.2775^2) = 0.6075 to 1.
    difference, interval = success_difference([True] * 10, [False] * 10)
    assert difference == 1 and interval == pytest.approx((0.6075, 1.0), abs=1e-4)
    # equal: 0 - sqrt(0.2775^2 + 0) to 0 + the same
    difference, interval = success_difference([True] * 10, [True] * 10)
    assert difference == 0 and interval == pytest.approx((-0.2775, 0.2775), abs=1e-4)


def test_a_positive_correlation_of_the_successes_narrows_the_interval() -> None:
    first, second = np.arange(50) < 25, np.arange(50) < 20
    _, (low, high) = success_difference(first.tolist(), second.tolist())
    _, (other_low, other_high) = success_difference(first.tolist(), second[::-1].tolist())
    assert high - low < 0.7 * (other_high - other_low)
    # both 20, neither 25, only first 5: phi = (20 * 25 - 50 / 2) / sqrt(25 * 25 * 20 * 30) = 0.7757;
    # Wilson: 0.5 (0.3664, 0.6336), 0.4 (0.2761, 0.5382);
    # 0.1 - sqrt(0.1336^2 - 2 * 0.7757 * 0.1336 * 0.1382 + 0.1382^2) = 0.0089
    # 0.1 + sqrt(0.1336^2 - 2 * 0.7757 * 0.1336 * 0.1239 + 0.1239^2) = 0.1867
    assert (low, high) == pytest.approx((0.0089, 0.1867), abs=3e-4)


def test_horizons_are_at_least_one_control_step() -> None:
    assert usable_horizons((0.16, 0.32, 0.64), 0.04) == (0.16, 0.32, 0.64)
    assert usable_horizons((0.16, 0.32, 0.64), 0.2) == (0.16, 0.32, 0.64)  # 1, 2 and 3 steps
    assert usable_horizons((0.16, 0.32, 0.64), 0.5) == (0.5,)  # each is one step
    assert usable_horizons((0.32,), 1.0) == (1.0,)


def test_a_task_without_goal_states_is_controlled_as_its_planning_problem() -> None:
    plant, notes = find_plant(find_task("reacher-trig"))
    assert plant is not None and plant.problem.name == "reacher"
    assert notes == (
        "The targets of reacher-trig are not states, so the planning problem reacher is controlled instead.",
    )


def test_what_cannot_be_controlled_is_said() -> None:
    task = find_task("cartpole-swingup")
    other = replace(task, problem="reacher")
    plant, notes = find_plant(other)
    assert plant is None and notes[0].startswith("Control is left out: task cartpole-swingup and its problem")


def test_each_cost_and_horizon_is_counted_from_the_same_first_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, int] = {}

    def control(plant: Any, embedding: Any, config: ControlConfig, out: Path, *, num: int, **_: Any) -> None:
        assert (embedding is None) == (config.cost == "reward")
        asked[out.name] = max(num, asked.get(out.name, 0))

    reached = {"z-0.32s": [True] * 4, "raw-0.32s": [True, False, True, False], "reward-0.16s": [True, True]}
    monkeypatch.setattr(run_control, "control_into", control)
    monkeypatch.setattr(run_control, "successes", lambda out: reached.get(out.name, [False] * 2))
    monkeypatch.setattr(run_control, "support_note", lambda *_: "the goal lies outside.")
    cells = ControlBudget(starts=4, samples=8, horizons=(0.16, 0.32), horizon_starts=2)
    task, embedding = find_task("cartpole-swingup"), load_embedding(GOLDEN)
    found = run_control.control_stage(task, embedding, Path("run"), cells, 0)
    assert found.reached is not None
    assert (found.reached.z, found.reached.raw, found.reached.difference) == (4, 2, 0.5)
    assert found.by_horizon == (("z", (0, 2)), ("raw", (0, 1)), ("reward", (2, 0)))
    assert asked == dict.fromkeys(("z-0.16s", "raw-0.16s", "reward-0.16s", "reward-0.32s"), 2) | {
        "z-0.32s": 4,
        "raw-0.32s": 4,
    }
    assert found.notes == ("The goal lies outside.",)


def budget() -> Budget:
    return replace(BUDGETS["smoke"], seeds=2, steps=8000)


def test_a_task_with_sin_and_cos_in_its_observation_has_two_arms() -> None:
    labels = [label for label, *_ in run_arms(find_task("reacher-trig"), budget(), 0)]
    assert labels == ["raw", "raw + z"]


def histories(shift: float, num: int = 5) -> dict[str, dict[str, np.ndarray]]:
    returns = np.tile(np.arange(num, dtype=float), (10, 1))
    return {
        "raw + sin/cos": {"steps": STEPS, "return": returns},
        "raw + sin/cos + z": {"steps": STEPS, "return": returns[:, ::-1] + shift},
    }


def test_verdicts_in_words() -> None:
    (tied,) = verdicts(histories(0.0))
    assert tied.startswith("5 seeds cannot separate raw + sin/cos from raw + sin/cos + z: the difference")
    assert "is +0 (95 % interval -" in tied
    (better,) = verdicts(histories(100.0))
    assert better.startswith(
        "raw + sin/cos + z earns more than raw + sin/cos: the difference in return is +100"
    )
    assert verdicts(histories(-100.0))[0].startswith("raw + sin/cos + z earns less than raw + sin/cos")
    assert verdicts(histories(0.0, 2)) == (
        "2 seeds are too few to compare raw + sin/cos + z with raw + sin/cos.",
    )
    assert verdicts({}) == ()


def test_shipped_bands_are_those_of_the_study() -> None:
    with STUDY.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["metric"] == "return"]
    bands = shipped_bands("cartpole-swingup", 960_000)
    labels = [label for label, *_ in run_arms(find_task("cartpole-swingup"), budget(), 0)]
    assert list(bands) == labels
    for label, band in bands.items():
        name = f"cartpole-swingup, TRPO/{label}"
        for i, step in enumerate(band.steps):
            own = [float(row["value"]) for row in rows if row["arm"] == name and int(row["step"]) == step]
            numbers = np.mean(own), np.sort(own)[1], np.sort(own)[-2]
            assert len(own) == 15
            np.testing.assert_allclose((band.mean[i], band.low[i], band.high[i]), numbers, atol=0.051)
    assert shipped_bands("cartpole-swingup", 40_000) == {} and shipped_bands("crane", 960_000) == {}
