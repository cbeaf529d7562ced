"""The manifest of a dataset: what the states mean, what produced it, and the hash of each shard."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypedDict

from planspace.demos.state_info import MODEL_FOLDER, StateInfo, parse_info
from planspace.errors import PlanspaceError
from planspace.storage.checks import reject_malformed
from planspace.storage.json_files import read_description, write_sealed

SCHEMA = 1
MANIFEST = "manifest.json"
MAX_STATES = 2**48
"""A shard that claims more states than this is rejected."""
SHARD_NAME = re.compile(r"shard-\d{5,9}\.safetensors")


class DatasetSettings(TypedDict, total=False):
    """The settings that determine the content of a dataset. Each way to make one uses some of the keys."""

    problem: str
    """Planning: hash of the problem. Otherwise its name."""
    seed: int
    """Planning: the seed of all plans."""
    planner: str
    """Planning: name of the planner."""
    config: Mapping[str, Any]
    """Planning: settings of the planner, as plain data."""
    versions: Mapping[str, str]
    """Planning: versions of the libraries that the numbers depend on."""
    imported: str
    """Import: name of the source."""
    sha256: str
    """Import: SHA-256 of the source files."""
    content: str
    """Import and `Demos.save`: `Demos.hash`."""
    split: Mapping[str, Sequence[int]]
    """Import and `Demos.save`: the demonstrations in each split, if the source or a file says it."""


@dataclass(frozen=True)
class Shard:
    """The entry of one shard."""

    file: str
    """Name of the file."""
    sha256: str
    """SHA-256 of the file."""
    episodes: int
    """Number of demonstrations."""
    states: int
    """Number of states."""


@dataclass(frozen=True)
class TreeShard:
    """The entry of one shard of search trees."""

    file: str
    """Name of the file in the folder `trees`."""
    sha256: str
    """SHA-256 of the file."""
    trees: int
    """Number of trees."""
    nodes: int
    """Number of nodes of all trees."""


@dataclass(frozen=True)
class Manifest:
    """The content of a manifest."""

    info: StateInfo
    """The meaning of the states."""
    settings: DatasetSettings
    """What determines the content of the dataset."""
    next_index: int = 0
    """The first demonstration that has not been attempted yet."""
    shards: tuple[Shard, ...] = ()
    """All shards, in order."""
    trees: tuple[TreeShard, ...] = ()
    """The shards of search trees: one for each of `shards`, or none."""


def read_manifest(folder: Path) -> Manifest:
    """Read and check the manifest of a dataset.

    Args:
        folder: the folder of the dataset.

    Raises:
        PlanspaceError: the manifest does not exist, is damaged, or has a newer schema.
    """
    file = folder / MANIFEST
    if not file.exists():
        what = f"is not a demo dataset: it has no {MANIFEST}" if folder.exists() else "does not exist"
        raise PlanspaceError(f"{folder} {what}. `planspace plan` and `planspace demos import` make datasets.")
    found = read_description(file, kind="demos", schema=SCHEMA)
    with reject_malformed(file):
        info = parse_info(found["info"], folder / MODEL_FOLDER)
        settings: DatasetSettings = found["settings"]
        next_index, shards = found["next_index"], found["shards"]
        if not isinstance(settings, dict) or type(next_index) is not int:
            raise TypeError("settings or next_index has the wrong type")
        if not isinstance(shards, list) or next_index < 0:
            raise ValueError("shards is not a list, or next_index is negative")
        if not isinstance(tree_shards := found.get("trees", []), list):
            raise TypeError("trees is not a list")
        trees = tuple(map(_tree_shard, tree_shards))
        manifest = Manifest(info, settings, next_index, tuple(map(_shard, shards)), trees)
        if len({shard.file for shard in manifest.shards}) < len(shards):
            raise ValueError("it lists a shard twice")
        if trees and [tree.trees for tree in trees] != [shard.episodes for shard in manifest.shards]:
            raise ValueError("its search trees are not those of its demonstrations")
    return manifest


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest of a dataset, with a checksum of its content."""
    write_sealed(
        folder / MANIFEST,
        {
            "schema": SCHEMA,
            "kind": "demos",
            "info": manifest.info.plain(),
            "settings": manifest.settings,
            "next_index": manifest.next_index,
            "shards": [asdict(shard) for shard in manifest.shards],
            **({"trees": [asdict(shard) for shard in manifest.trees]} if manifest.trees else {}),
        },
    )


def _shard(entry: Mapping[str, Any]) -> Shard:
    episodes, states = entry["episodes"], entry["states"]
    if type(episodes) is not int or type(states) is not int or not 0 < episodes <= states < MAX_STATES:
        raise ValueError(f"a shard cannot have {episodes} demonstrations and {states} states")
    return Shard(str(entry["file"]), str(entry["sha256"]), episodes, states)


def _tree_shard(entry: Mapping[str, Any]) -> TreeShard:
    trees, nodes = entry["trees"], entry["nodes"]
    if type(trees) is not int or type(nodes) is not int or not 0 < trees <= nodes < MAX_STATES:
        raise ValueError(f"a shard cannot have {trees} search trees and {nodes} nodes")
    return TreeShard(str(entry["file"]), str(entry["sha256"]), trees, nodes)
