"""Search trees: their arithmetic, and datasets that keep them."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.cli import main
from planspace.cli.repair import repair
from planspace.demos.convert import export_demos
from planspace.demos.dataset import Demos
from planspace.demos.describe import describe
from planspace.demos.folder import DemoFolder
from planspace.demos.load import load_demos
from planspace.demos.manifest import MANIFEST
from planspace.demos.search_tree import SearchTree, as_tree
from planspace.demos.stored import StoredDemos
from planspace.errors import PlanspaceError
from planspace.storage.arrays import read_arrays, write_arrays
from planspace.storage.files import file_hash
from planspace.storage.json_files import read_sealed, write_sealed

from .test_folder import INFO, episode

#     0 -- 0.1 -- 1 -- 0.2 -- 3
#      \__ 0.5 -- 2 -- 0.1 -- 4 -- 0.4 -- 5
TREE = SearchTree(
    np.arange(12.0).reshape(6, 2), np.array([-1, 0, 0, 1, 2, 4]), np.array([0, 0.1, 0.5, 0.2, 0.1, 0.4])
)
SHARD = "shard-00000.safetensors"


def random_tree(rng: np.random.Generator, nodes: int) -> SearchTree:
    parents = np.array([-1, *(int(rng.integers(0, i)) for i in range(1, nodes))])
    durations = np.concatenate([[0.0], rng.uniform(0.02, 0.2, nodes - 1)])
    return SearchTree(rng.normal(size=(nodes, 2)), parents, durations)


def with_tree(index: int, nodes: int = 6):
    e = episode(index)
    tree = random_tree(np.random.default_rng(index), nodes)
    return replace(e, tree=replace(tree, states=np.concatenate([e.states[:1], tree.states[1:]])))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    target = DemoFolder(tmp_path / "demos", INFO, {"seed": 0})
    target.append([with_tree(0), with_tree(1, 9)], 2)
    target.append([with_tree(2, 1)], 3)
    return tmp_path / "demos"


def test_times_and_paths_by_hand() -> None:
    np.testing.assert_allclose(TREE.times, [0, 0.1, 0.5, 0.3, 0.6, 1.0])
    assert TREE.path(5).tolist() == [0, 2, 4, 5]


def test_a_kept_node_keeps_its_ancestors() -> None:
    kept = TREE.keep(np.array([4]))  # and with it nodes 2 and 0
    np.testing.assert_array_equal(kept.states, TREE.states[[0, 2, 4]])
    assert kept.parents.tolist() == [-1, 0, 1]
    np.testing.assert_allclose(kept.times, [0, 0.5, 0.6])


@pytest.mark.parametrize("most", [1, 2, 50, 299])
def test_a_thinned_tree_is_closed_under_ancestors_and_keeps_all_times(
    rng: np.random.Generator, most: int
) -> None:
    tree = random_tree(rng, 300)
    thinned = tree.thin(most, np.random.default_rng(1))
    assert len(thinned) == most  # single nodes next to the tree fill it up
    as_tree(thinned, 2)
    number = {state.tobytes(): node for node, state in enumerate(tree.states)}
    nodes = [number[state.tobytes()] for state in thinned.states]
    np.testing.assert_allclose(thinned.times, tree.times[nodes])
    np.testing.assert_array_equal(np.array(nodes)[thinned.parents[1:]], tree.parents[nodes[1:]])
    again = tree.thin(most, np.random.default_rng(1))
    np.testing.assert_array_equal(again.states, thinned.states)
    assert tree.thin(300, rng) is tree


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"parents": np.array([-1, 0, 0, 1, 5, 4])}, "the parent of a node must have a lower number"),
        ({"parents": np.array([-1, 0, 0, -1, 2, 4])}, "only node 0 has the parent -1"),
        ({"durations": np.array([0, 0.1, 0, 0.2, 0.1, 0.4])}, "durations of a search tree must be positive"),
        ({"states": np.full((6, 2), np.nan)}, "a number that is not finite"),
    ],
)
def test_what_is_not_a_tree_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        as_tree(replace(TREE, **changes), 2)
    with pytest.raises(ValueError, match=r"states of shape \(6, 3\) and durations of shape \(6,\), got"):
        as_tree(TREE, 3)
    with pytest.raises(ValueError, match="expected a SearchTree, got list"):
        as_tree([], 2)


def test_trees_are_stored_beside_their_demonstrations(folder: Path, tmp_path: Path) -> None:
    demos, stored = load_demos(folder), StoredDemos(folder)
    assert [len(tree) for tree in demos.trees] == [6, 9, 1]
    for i, tree in enumerate(demos.trees):
        expected = with_tree(i, [6, 9, 1][i]).tree
        assert expected is not None
        for name in ("states", "parents", "durations"):
            np.testing.assert_array_equal(getattr(tree, name), getattr(expected, name))
    assert "search trees  16 nodes" in repr(demos)
    assert describe(folder)["search_trees"] == {"trees": 3, "nodes": 16}
    assert stored.hash == demos.hash
    assert [len(part.trees) for part in stored.shards()] == [2, 1]
    demos.save(tmp_path / "copy")
    assert load_demos(tmp_path / "copy").hash == demos.hash
    (selected,) = {tree.states.shape[1] for tree in demos.select(["v"]).trees}
    assert selected == 1


def test_trees_change_the_hash_but_not_the_shards_of_demonstrations(folder: Path, tmp_path: Path) -> None:
    plain = DemoFolder(tmp_path / "plain", INFO, {"seed": 0})
    plain.append([episode(0), episode(1)], 2)
    assert (tmp_path / "plain" / SHARD).read_bytes() == (folder / SHARD).read_bytes()
    assert not (tmp_path / "plain" / "trees").exists()
    assert "trees" not in read_sealed(tmp_path / "plain" / MANIFEST)
    demos = load_demos(folder)
    assert replace(demos, trees=()).hash != demos.hash
    assert Demos.from_episodes(INFO, [with_tree(0), episode(1)]).trees == ()


def test_demonstrations_without_a_tree_are_not_added_to_those_with_one(folder: Path) -> None:
    with pytest.raises(PlanspaceError, match="demonstrations without a tree cannot be added to it"):
        DemoFolder(folder, INFO, {"seed": 0}).append([episode(3)], 4)


def test_an_export_says_that_it_leaves_the_trees_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    export_demos(load_demos(folder), str(tmp_path / "demos.npz"))
    assert capsys.readouterr().err == f"{tmp_path / 'demos.npz'}: the search trees are not exported\n"


def flip_a_byte(folder: Path) -> None:
    data = bytearray((folder / "trees" / SHARD).read_bytes())
    data[-1] ^= 1
    (folder / "trees" / SHARD).write_bytes(data)


def change_arrays(change: Callable[[dict[str, np.ndarray]], None]) -> Callable[[Path], None]:
    """Change the arrays of a shard and correct all hashes, as someone with bad intentions would."""

    def attack(folder: Path) -> None:
        arrays = read_arrays(folder / "trees" / SHARD)
        change(arrays)
        write_arrays(folder / "trees" / SHARD, arrays)
        sha256 = file_hash(folder / "trees" / SHARD)
        change_manifest(lambda text: text["trees"][0].update(sha256=sha256))(folder)

    return attack


def change_manifest(change: Callable[[dict], object]) -> Callable[[Path], None]:
    def attack(folder: Path) -> None:
        text = read_sealed(folder / MANIFEST)
        change(text)
        write_sealed(folder / MANIFEST, text)

    return attack


BAD: dict[str, tuple[Callable[[Path], None], str]] = {
    "a byte": (flip_a_byte, "trees/shard-00000.safetensors was altered or damaged"),
    "missing": (lambda f: (f / "trees" / SHARD).unlink(), "cannot read .*trees/shard-00000.safetensors"),
    "other start": (change_arrays(lambda a: a["states"].__setitem__(0, 7.0)), "does not start where its"),
    "a loop": (change_arrays(lambda a: a["parents"].__setitem__(2, 5)), "must have a lower number"),
    "offsets": (change_arrays(lambda a: a["offsets"].__setitem__(1, 15)), "do not cover its nodes"),
    "types": (change_arrays(lambda a: a.update(parents=a["parents"] * 1.0)), "parents has shape"),
    "no array": (change_arrays(lambda a: a.__delitem__("durations")), "durations"),
    "a path": (change_manifest(lambda t: t["trees"][0].update(file="../x")), "not a valid shard name"),
    "a number": (change_manifest(lambda t: t["trees"][0].update(nodes=10**15)), "cannot have"),
    "one less": (change_manifest(lambda t: t["trees"].pop()), "are not those of its demonstrations"),
    "no list": (change_manifest(lambda t: t.update(trees={})), "trees is not a list"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_shards_are_refused_in_one_line(
    folder: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    attack, message = BAD[name]
    attack(folder)
    assert main(["demos", "show", str(folder)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and re.search(message, error), error


def test_repair_keeps_what_comes_before_a_damaged_tree(folder: Path) -> None:
    flipped = folder / "trees" / "shard-00001.safetensors"
    flipped.write_bytes(flipped.read_bytes()[:-1])
    (line,) = repair(folder)
    assert "trees/shard-00001.safetensors" in line
    assert len(load_demos(folder).trees) == 2
    again = DemoFolder(folder, INFO, {"seed": 0})
    assert again.next_index == 2
    again.append([with_tree(2, 1)], 3)
    assert len(load_demos(folder).trees) == 3
