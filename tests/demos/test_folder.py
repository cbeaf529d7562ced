import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.describe import describe
from planspace.demos.episode import Episode
from planspace.demos.folder import DemoFolder
from planspace.demos.load import load_demos
from planspace.demos.state_info import StateInfo
from planspace.demos.stored import StoredDemos
from planspace.demos.triplets import random_triplets
from planspace.errors import PlanspaceError
from planspace.storage.json_files import read_sealed, write_sealed

INFO = StateInfo(("x", "v"), ("m", "m/s"), (), 1)


def episode(index: int, length: int = 5) -> Episode:
    states = np.arange(2.0 * length).reshape(length, 2) + index
    return Episode(
        states, np.ones((length - 1, 1)), np.arange(length) * 0.1, np.zeros(2), True, index, seed=0
    )


def test_the_content_does_not_depend_on_the_division_into_shards(tmp_path: Path) -> None:
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


def test_errors_name_a_missing_or_altered_shard(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)
    shard = tmp_path / "shard-00000.safetensors"
    data = bytearray(shard.read_bytes())
    data[-1] ^= 1
    shard.write_bytes(data)
    with pytest.raises(PlanspaceError, match=r"shard-00000.safetensors was altered or damaged"):
        load_demos(tmp_path)
    shard.unlink()
    with pytest.raises(PlanspaceError, match=r"shard-00000.safetensors is missing. Restore it"):
        load_demos(tmp_path)


def test_an_altered_manifest_is_found(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)
    manifest = tmp_path / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"m/s"', '"km/h"'))
    with pytest.raises(PlanspaceError, match="does not match its own checksum"):
        load_demos(tmp_path)


def test_errors_name_the_settings_that_differ(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {"seed": 0}).append([episode(0)], 1)
    with pytest.raises(PlanspaceError, match="other settings: seed was 0, now 1"):
        DemoFolder(tmp_path, INFO, {"seed": 1})


def test_a_folder_with_other_files_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text("my notes\n")
    (tmp_path / "thesis.tex").write_text("chapter 1\n")
    with pytest.raises(PlanspaceError, match=r"not a demo dataset \(it holds 'thesis.tex'\); choose another"):
        DemoFolder(tmp_path, INFO, {})
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.jsonl", "thesis.tex"]


def test_errors_name_the_row_of_a_nan(tmp_path: Path) -> None:
    bad = episode(4)
    bad.states[3, 1] = np.nan
    with pytest.raises(PlanspaceError, match="demonstration 4, row 3: v is not finite"):
        DemoFolder(tmp_path, INFO, {}).append([bad], 1)
    assert not (tmp_path / "manifest.json").exists()


def test_a_stored_dataset_is_read_one_shard_at_a_time(tmp_path: Path) -> None:
    folder = DemoFolder(tmp_path, INFO, {})
    folder.append([episode(0), episode(1, 3)], 2)
    folder.append([episode(2, 7)], 3)
    stored, whole = StoredDemos(tmp_path), load_demos(tmp_path)
    assert [len(part) for part in stored.shards()] == [2, 1] and len(stored) == 3
    assert stored.hash == whole.hash
    np.testing.assert_array_equal(stored.offsets, whole.offsets)
    np.testing.assert_equal(stored.split(0), whole.split(0))
    for i, e in enumerate(stored.episodes()):
        np.testing.assert_array_equal(e.states, whole.episode(i).states)
        assert e.index == i
    rows = [random_triplets(d, np.array([0, 2]), 50, np.random.default_rng(0), 0.5) for d in (stored, whole)]
    np.testing.assert_array_equal(*rows)
    np.testing.assert_array_equal(stored.states_at(rows[0]), whole.states[rows[0]])


def test_the_hash_does_not_depend_on_number_types(tmp_path: Path) -> None:
    single = replace(episode(0), states=episode(0).states.astype(np.float32))
    DemoFolder(tmp_path, INFO, {}).append([single], 1)
    assert (
        StoredDemos(tmp_path).hash
        == load_demos(tmp_path).hash
        == Demos.from_episodes(INFO, [episode(0)]).hash
    )


def test_files_in_other_folders_are_not_opened(tmp_path: Path) -> None:
    DemoFolder(tmp_path / "demos", INFO, {}).append([episode(0)], 1)
    DemoFolder(tmp_path / "other", INFO, {}).append([episode(0)], 1)
    manifest = read_sealed(tmp_path / "demos" / "manifest.json")
    manifest["shards"][0]["file"] = "../other/shard-00000.safetensors"
    write_sealed(tmp_path / "demos" / "manifest.json", manifest)
    stored = StoredDemos(tmp_path / "demos")
    for read in (lambda: list(stored.shards()), lambda: stored.hash, lambda: stored.states_at(np.array([0]))):
        with pytest.raises(PlanspaceError, match="is not a valid shard name"):
            read()


@pytest.mark.parametrize(
    "change", [{"episodes": -5}, {"episodes": 10**15}, {"states": 1e3}, {"states": 2**60}]
)
def test_an_invalid_manifest_is_refused(change: dict, tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)
    manifest = read_sealed(tmp_path / "manifest.json")
    manifest["shards"][0] |= change
    write_sealed(tmp_path / "manifest.json", manifest)
    with pytest.raises(PlanspaceError, match=r"manifest\.json was altered or damaged: its .* is invalid"):
        describe(tmp_path)


def test_rows_out_of_range_are_refused(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)
    stored = StoredDemos(str(tmp_path))
    for row in (-1, 5):
        with pytest.raises(
            PlanspaceError, match=rf"rows {row} to {row} are out of range; .* has rows 0 to 4"
        ):
            stored.states_at(np.array([row]))


def test_a_damaged_dataset_has_no_hash(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)
    shard = tmp_path / "shard-00000.safetensors"
    data = bytearray(shard.read_bytes())
    data[-1] ^= 1
    shard.write_bytes(data)
    with pytest.raises(PlanspaceError, match="was altered or damaged"):
        _ = StoredDemos(tmp_path).hash


def test_a_shard_that_is_larger_than_its_manifest_allows_is_not_read(tmp_path: Path) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)
    shard = tmp_path / "shard-00000.safetensors"
    os.truncate(shard, 1 << 20)
    with pytest.raises(
        PlanspaceError, match=rf"{shard} was altered .*{1 << 20} bytes, its manifest allows at"
    ):
        load_demos(tmp_path)


def test_the_size_limit_admits_a_shard_of_many_short_demonstrations(tmp_path: Path) -> None:
    states, times = np.zeros((2, 2)), np.arange(2.0)
    short = [Episode(states, np.zeros((1, 1)), times, np.zeros(2), True, i, seed=0) for i in range(2000)]
    DemoFolder(tmp_path, INFO, {}).append(short, 2000)
    assert len(load_demos(tmp_path)) == 2000


def test_running_out_of_memory_is_a_short_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    DemoFolder(tmp_path, INFO, {}).append([episode(0)], 1)

    def fail(_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(np, "concatenate", fail)
    with pytest.raises(PlanspaceError, match=f"not enough memory to read {tmp_path}"):
        load_demos(tmp_path)
