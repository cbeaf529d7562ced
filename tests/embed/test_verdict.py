from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.embed.demo_quality import DemoQuality, examine
from planspace.embed.embedding import Embedding
from planspace.embed.geometry import Geometry
from planspace.embed.measurement import measure_embedding
from planspace.embed.verdict import Verdict, judge

GOOD = Geometry(0.88, 0.25, 0.07, 0.97, 0.15, 0.15, 0.1, 2.2, 3, 0.24, 48)
RAW = replace(GOOD, straightness=0.13, midpoint_error=0.6, decoded_error=0.0, active_dims=4)
SMOOTH = DemoQuality(500, 150, 0.02, {1: 0.98, 2: 0.95, 4: 0.9}, 0.0, 0.0, 0)
CHECKS = {"change_by_a_turn": 1e-6, "change_by_a_sign": None, "outside_support": 0.01}
TIME = np.linspace(0, 1, 401)[:, None]


def demos_of(*paths: np.ndarray, reached: bool = True, goal: float = 0.0) -> Demos:
    info = StateInfo(tuple("abcd"[: paths[0].shape[1]]), ("",) * paths[0].shape[1], (), 0)
    episodes = [
        Episode(
            x, np.zeros((len(x) - 1, 0)), np.arange(len(x)) * 0.05, np.full(x.shape[1], goal), reached, i, 0
        )
        for i, x in enumerate(paths)
    ]
    return Demos.from_episodes(info, episodes)


def verdict_of(z: Geometry = GOOD, quality: DemoQuality = SMOOTH, **checks: float) -> Verdict:
    return judge({"test": (z, RAW)}, quality, CHECKS | checks, 3)


def said(sentences: tuple[str, ...], words: str) -> bool:
    return any(words in sentence for sentence in sentences)


def test_smooth_paths_keep_their_length_at_half_the_rate() -> None:
    found = examine(demos_of(np.column_stack([np.cos(2 * TIME[:, 0]), np.sin(2 * TIME[:, 0])])))
    assert found.length_kept[1] == pytest.approx(1.0, abs=1e-4)
    assert (found.num_demos, found.num_states, found.off_goal) == (1, 401, 0)
    assert found.step_s == pytest.approx(0.05)
    assert found.spacings_s == pytest.approx((0.25, 0.5, 1.5))


def test_noise_keeps_half_of_its_length_and_a_random_walk_its_root() -> None:
    """Steps of white noise have the same length at any spacing; those of a random walk grow by sqrt(2)."""
    rng = np.random.default_rng(0)
    noise, walk = rng.normal(size=(4001, 4)), rng.normal(size=(4001, 4)).cumsum(axis=0)
    assert examine(demos_of(noise)).length_kept[1] == pytest.approx(0.5, abs=0.01)
    kept = examine(demos_of(walk)).length_kept
    assert list(kept) == [1, 2, 4, 8, 16, 32]
    assert [kept[k] for k in (1, 2, 4, 8)] == pytest.approx([np.sqrt(0.5)] * 4, abs=0.03)


def test_the_units_of_the_states_make_no_difference() -> None:
    walk = np.random.default_rng(0).normal(size=(200, 3)).cumsum(axis=0)
    kept = [examine(demos_of(walk * scale)).length_kept[1] for scale in (1.0, np.array([1, 1e4, 1e-4]))]
    assert kept[0] == pytest.approx(kept[1])


def test_a_cycle_is_visited_again_and_a_line_is_not() -> None:
    """Four turns of a circle: all states but those of the last turn are visited again."""
    circle = np.column_stack([np.cos(8 * np.pi * TIME[:, 0]), np.sin(8 * np.pi * TIME[:, 0])])
    assert examine(demos_of(circle)).revisiting == pytest.approx(0.75, abs=0.03)
    assert examine(demos_of(np.column_stack([TIME, TIME**2]))).revisiting == 0.0
    waiting = np.concatenate([np.tile([[0.0, 0.0]], (400, 1)), np.column_stack([TIME, TIME])])
    found = examine(demos_of(waiting))
    assert found.revisiting == 0.0  # it never left
    assert found.standing_still == pytest.approx(0.5, abs=0.01)


def test_demonstrations_off_their_goal_are_counted() -> None:
    assert examine(demos_of(TIME, TIME, reached=False)).off_goal == 2
    assert examine(demos_of(TIME, reached=False, goal=np.nan)).off_goal is None  # no goal is known


def test_a_good_embedding_of_good_demonstrations() -> None:
    found = verdict_of()
    assert found.weak == found.not_supported == found.advice == ()
    assert found.good == (
        "Demonstrations are nearly straight in z (straightness 0.88, raw state 0.13).",
        "The distance to the end follows the time left (0.97).",
        "z keeps the state (decoded error 0.24).",
        "A full turn of an angle does not move z.",
    )
    assert list(found.to_dict()) == ["good", "weak", "not_supported", "try"]


@pytest.mark.parametrize(
    ("changed", "weak", "advice"),
    [
        ({"straightness": 0.2}, "not straighter in z", "--linearity"),
        ({"decoded_error": 1.3}, "lost most of the state", "--z-dim"),
        ({"active_dims": 2}, "Only 2 of 3 dimensions", "--prior"),
        ({"num_demos": 1}, "Only 1 demonstration of the test split", "--folds"),
    ],
)
def test_what_is_weak_comes_with_advice(changed: dict[str, Any], weak: str, advice: str) -> None:
    found = verdict_of(replace(GOOD, **changed))
    assert said(found.weak, weak) and said(found.advice, advice)
    assert len(found.weak) == len(found.advice) == 1


def test_changes_by_symmetries_come_with_advice() -> None:
    for name in ("change_by_a_turn", "change_by_a_sign"):
        found = verdict_of(**{name: 0.4})
        assert said(found.weak, "moves z by 0.4 standard deviations") and said(found.advice, "--inputs trig")


def test_a_straight_training_split_does_not_hide_a_crooked_test_split() -> None:
    measured = {"train": (GOOD, RAW), "test": (replace(GOOD, straightness=0.5), RAW)}
    assert said(judge(measured, SMOOTH, CHECKS, 3).weak, "(0.88 against 0.50)")


@pytest.mark.parametrize(
    ("changed", "reason", "advice"),
    [
        ({"num_demos": 9}, "Too few: 9", "Collect more"),
        ({"length_kept": {1: 0.6, 2: 0.8, 4: 0.93}}, "Too noisy", "12.5 Hz"),  # 1 / (4 * 0.02 s)
        ({"length_kept": {1: 0.7, 2: 0.7}}, "Too noisy", "not smooth at any lower rate"),
        ({"num_states": 5000}, "Too fine: 5,000", "--rate 2"),  # 200 states in 100 s
        ({"revisiting": 0.4}, "Revisiting: 40 %", "Divide"),
        ({"standing_still": 0.5}, "Pauses: 50 %", "pauses"),
        ({"off_goal": 3}, "Off-goal: 3 of 500", "failed"),
    ],
)
def test_what_the_demonstrations_do_not_support(changed: dict[str, Any], reason: str, advice: str) -> None:
    found = verdict_of(quality=replace(SMOOTH, **changed))
    assert len(found.not_supported) == len(found.advice) == 1
    assert found.not_supported[0].startswith(reason) and advice in found.advice[0]


def test_a_measurement_contains_the_verdict(embedding: Embedding, demos: Demos) -> None:
    found = measure_embedding(embedding, demos).to_dict()
    assert said(found["verdict"]["weak"], "Only 1 demonstration of the test split")
    assert found["demonstrations"]["num_demos"] == 12
    assert found["demonstrations"]["length_kept"][1] > 0.9  # planned
