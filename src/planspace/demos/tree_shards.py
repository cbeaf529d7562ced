"""Shards of search trees: safetensors files in the folder `trees` of a dataset, one for each shard.

Tree i of a shard is the tree of demonstration i of the demonstrations' shard with the same number.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planspace.demos.manifest import MANIFEST, SHARD_NAME, TreeShard
from planspace.demos.search_tree import SearchTree, check_tree, join_trees, split_trees
from planspace.demos.shards import HEADER_BYTES, shard_name
from planspace.demos.state_info import StateInfo
from planspace.storage.arrays import Arrays, read_arrays, write_arrays
from planspace.storage.checks import check_file, damage_error, reject_malformed
from planspace.storage.files import make_folder

FOLDER = "trees"
KINDS = {"states": "f", "parents": "i", "durations": "f", "offsets": "i"}
"""The arrays in a shard and the kinds of their numbers."""


def write_trees(folder: Path, number: int, trees: Sequence[SearchTree]) -> TreeShard:
    """Write some search trees.

    Args:
        folder: the folder of the dataset.
        number: number of the shard, starting at 0.
        trees: one for each demonstration of the shard.

    Returns:
        The entry for the manifest.
    """
    name, arrays = shard_name(number), join_trees(trees)
    sha256 = write_arrays(make_folder(folder / FOLDER) / name, arrays)
    return TreeShard(name, sha256, trees=len(trees), nodes=len(arrays["parents"]))


def read_trees(folder: Path, shard: TreeShard, info: StateInfo) -> tuple[SearchTree, ...]:
    """Read and verify the search trees of a shard.

    Raises:
        PlanspaceError: the shard does not exist, was altered, or contradicts its entry in the manifest.
    """
    with reject_malformed(folder / MANIFEST):
        if not SHARD_NAME.fullmatch(shard.file):
            raise ValueError(f"{shard.file!r} is not a valid shard name")
    file = folder / FOLDER / shard.file
    most = HEADER_BYTES + 8 * (shard.nodes * (len(info.names) + 2) + shard.trees + 1)
    check_file(file)
    if (size := file.stat().st_size) > most:
        raise damage_error(file, f"it has {size} bytes, its manifest allows at most {most}")
    arrays = read_arrays(file, sha256=shard.sha256)
    with reject_malformed(file):
        _check_offsets(arrays, shard)
        trees = split_trees(arrays)
        for tree in trees:
            check_tree(tree, len(info.names))
    return trees


def _check_offsets(arrays: Arrays, shard: TreeShard) -> None:
    for name, kind in KINDS.items():
        if arrays[name].dtype.kind != kind or len(arrays[name]) != (
            shard.trees + 1 if name == "offsets" else shard.nodes
        ):
            raise ValueError(f"{name} has shape {arrays[name].shape} and type {arrays[name].dtype}")
    offsets = arrays["offsets"]
    if offsets.ndim != 1 or offsets[0] != 0 or offsets[-1] != shard.nodes or not (np.diff(offsets) > 0).all():
        raise ValueError("its offsets do not cover its nodes")
