"""Datasets are joined if they are of the same robot and of different demonstrations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace import UsageError, load_demos
from planspace.demos.dataset import Demos
from planspace.demos.merge import merge_demos

from ..cli.calls import call
from .test_folder import INFO, episode
from .test_search_tree import with_tree


def parts_of(demos: Demos) -> tuple[Demos, Demos]:
    episodes = [demos.episode(i) for i in range(len(demos))]
    return Demos.from_episodes(demos.info, episodes[:5]), Demos.from_episodes(demos.info, episodes[5:])


def test_the_parts_of_a_dataset_are_the_dataset(
    demos: Demos, demo_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [tmp_path / name for name in ("one", "two")]
    for part, folder in zip(parts_of(demos), folders, strict=True):
        part.save(folder)
    out = tmp_path / "merged"
    code, printed, _ = call(capsys, "demos", "merge", *folders, "--out", out)
    assert code == 0 and "12 demonstrations of cartpole-swingup" in printed
    merged = load_demos(out)
    np.testing.assert_array_equal(merged.states, demos.states)
    np.testing.assert_array_equal(merged.controls, demos.controls)
    np.testing.assert_array_equal(merged.indices, np.arange(12))


def test_trees_are_kept_if_all_parts_have_them() -> None:
    first, second, bare = (
        Demos.from_episodes(INFO, [make(i)]) for i, make in enumerate([with_tree] * 2 + [episode])
    )
    merged = merge_demos([first, second])
    for tree, part in zip(merged.trees, (first, second), strict=True):
        np.testing.assert_array_equal(tree.states, part.trees[0].states)
    assert not merge_demos([first, bare]).trees


def test_what_is_not_of_the_same_robot_or_twice_the_same_is_refused(demos: Demos) -> None:
    one, two = parts_of(demos)
    with pytest.raises(UsageError, match="two datasets or more"):
        merge_demos([one])
    with pytest.raises(UsageError, match="b and a differ in their models"):
        merge_demos([one, replace(two, info=replace(two.info, source=None))], ["a", "b"])
    with pytest.raises(UsageError, match="dataset 3 and dataset 1 differ in their names"):
        merge_demos([one, two, replace(two, info=replace(two.info, names=("a", "b", "c", "d")))])
    with pytest.raises(UsageError, match="demonstration 0 of dataset 2 equals demonstration 5 of dataset 1"):
        merge_demos([demos, two])
