from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.describe import replay_errors
from planspace.demos.episode import Episode
from planspace.demos.load import load_demos
from planspace.demos.state_info import StateInfo
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


def test_the_split_is_seeded_and_complete(demos: Demos) -> None:
    split = demos.split(0)
    together = np.concatenate(list(split.values()))
    assert sorted(together) == list(range(len(demos)))
    assert [len(part) for part in split.values()] == [10, 1, 1]
    assert all((a == b).all() for a, b in zip(split.values(), demos.split(0).values(), strict=True))
    assert any((a != b).any() for a, b in zip(split.values(), demos.split(1).values(), strict=True))
    with pytest.raises(
        PlanspaceError,
        match="a split into training, validation and test needs at least 3 demonstrations, got 2",
    ):
        Demos.from_episodes(INFO, [episode(0), episode(1)]).split(0)


def test_save_and_load(demos: Demos, tmp_path: Path) -> None:
    demos.save(tmp_path / "demos")
    saved = load_demos(tmp_path / "demos")
    assert saved.hash == demos.hash
    for name in ("success", "indices", "seeds", "costs"):
        np.testing.assert_array_equal(getattr(saved, name), getattr(demos, name))
    before = (tmp_path / "demos" / "manifest.json").read_bytes()
    demos.save(tmp_path / "demos")  # saving the same demonstrations again changes nothing
    assert (tmp_path / "demos" / "manifest.json").read_bytes() == before
    with pytest.raises(PlanspaceError, match="made with other settings: content has changed"):
        demos.select(("hinge",)).save(tmp_path / "demos")
    for change in ({"success": ~demos.success}, {"costs": demos.costs + 1.0}, {"seeds": demos.seeds + 1}):
        with pytest.raises(PlanspaceError, match=f"the same demonstrations with other {next(iter(change))}"):
            replace(demos, **change).save(tmp_path / "demos")


def test_summaries_are_short(demos: Demos) -> None:
    lines = repr(demos).splitlines()
    assert lines[0] == "Demos: 12 demonstrations of cartpole-swingup"
    assert lines[1].endswith("each (slider [m], hinge [rad], slidervel [m/s], hingevel [rad/s])")
    assert lines[-1] == "  at the goal  12 of 12"
    assert len(lines) == 5 and max(map(len, lines)) < 110
    page = demos._repr_html_()
    assert len(page) < 1000 and "12 demonstrations of cartpole-swingup" in page
    assert len(repr(demos.info)) < 500  # the model is left out


def test_a_summary_lists_a_few_names_and_escapes_them() -> None:
    names = tuple(f"<b{i}>" for i in range(30))
    info = StateInfo(names, ("",) * 30, (), 1)
    states = np.zeros((2, 30))
    demos = Demos.from_episodes(
        info, [Episode(states, np.zeros((1, 1)), np.arange(2.0), states[0], False, 0, seed=0)]
    )
    assert "<b7>, ... (30 in all)" in repr(demos) and "<b8>" not in repr(demos)
    assert "<b7>" not in demos._repr_html_() and "&lt;b7&gt;" in demos._repr_html_()
