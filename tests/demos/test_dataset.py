from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import DemoFolder, Demos, Episode, StateInfo, load_demos
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


def test_shards_lie_end_to_end_whatever_the_cuts(tmp_path: Path) -> None:
    one, three = DemoFolder(tmp_path / "one", INFO, {}), DemoFolder(tmp_path / "three", INFO, {})
    episodes = [episode(0), episode(1, 3), episode(2, 7)]
    one.append(episodes, 3)
    for i, e in enumerate(episodes):
        three.append([e], i + 1)
    a, b = load_demos(tmp_path / "one"), load_demos(tmp_path / "three")
    assert a.hash == b.hash
    for i, e in enumerate(episodes):
        np.testing.assert_array_equal(b.episode(i).states, e.states)
        np.testing.assert_array_equal(b.episode(i).controls, e.controls)
    changed = Demos.from_episodes(INFO, [*episodes[:2], episode(3, 7)])
    assert changed.hash != a.hash


def test_a_missing_or_altered_shard_is_named(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)
    shard = tmp_path / "shard-00000.safetensors"
    data = bytearray(shard.read_bytes())
    data[-1] ^= 1
    shard.write_bytes(data)
    with pytest.raises(PlanspaceError, match=r"shard-00000.safetensors was altered or damaged"):
        load_demos(tmp_path)
    shard.unlink()
    with pytest.raises(PlanspaceError, match=r"cannot read .*shard-00000.safetensors: No such file"):
        load_demos(tmp_path)


def test_an_altered_manifest_is_found(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)
    manifest = tmp_path / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"m/s"', '"km/h"'))
    with pytest.raises(PlanspaceError, match="does not match its own checksum"):
        load_demos(tmp_path)


def test_other_settings_are_refused_with_the_difference(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {"seed": 0}).append([episode(0)], 1)
    with pytest.raises(PlanspaceError, match="other settings: seed was 0, now 1"):
        DemoFolder(tmp_path, INFO, {"seed": 1})


def test_nan_is_refused_with_its_place(tmp_path: Path) -> None:
    bad = episode(4)
    bad.states[3, 1] = np.nan
    with pytest.raises(PlanspaceError, match="demonstration 4 holds a state that is not finite, in row 3"):
        DemoFolder(tmp_path, INFO, {}).append([bad], 1)
    assert not (tmp_path / "manifest.json").exists()


def test_split_is_by_demo_seeded_and_complete(demos: Demos) -> None:
    split = demos.split(0)
    together = np.concatenate(list(split.values()))
    assert sorted(together) == list(range(len(demos)))
    assert [len(part) for part in split.values()] == [10, 1, 1]
    assert all((a == b).all() for a, b in zip(split.values(), demos.split(0).values(), strict=True))
    assert any((a != b).any() for a, b in zip(split.values(), demos.split(1).values(), strict=True))
    with pytest.raises(PlanspaceError, match="2 demonstrations cannot be split in three"):
        Demos.from_episodes(INFO, [episode(0), episode(1)]).split(0)
