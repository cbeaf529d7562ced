"""A dataset on disk: immutable shards under one sealed manifest, written one shard at a time.

DIR/manifest.json              what the states mean, the model, and each shard with its SHA-256
DIR/model/...                  the files of a model that has more than one
DIR/shard-00000.safetensors    some episodes, their arrays laid end to end
DIR/trees/shard-00000.safetensors    their search trees, if they were kept
DIR/log.jsonl                  dates, failures and simulated steps; not part of any hash
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from planspace.demos.episode import Episode, join_episodes, trees_of
from planspace.demos.manifest import (
    MANIFEST,
    SHARD_NAME,
    DatasetSettings,
    Manifest,
    read_manifest,
    write_manifest,
)
from planspace.demos.shards import read_shard, shard_name, write_shard
from planspace.demos.state_info import MODEL_FOLDER, StateInfo
from planspace.demos.tree_shards import FOLDER, read_trees, write_trees
from planspace.errors import PlanspaceError
from planspace.storage.checks import reject_malformed
from planspace.storage.files import make_folder
from planspace.storage.repair import PREFIX
from planspace.storage.runs import refuse_other_files
from planspace.storage.settings import list_differences

LOG = "log.jsonl"
"""The name of the log, which planning writes."""
OWN = rf"[.].*|{PREFIX}.*|{MODEL_FOLDER}|{FOLDER}|{LOG}|{SHARD_NAME.pattern}"
"""Names in a folder without a manifest that an interrupted or repaired dataset may have."""
SHARD_EPISODES, SHARD_STATES = 256, 100_000
"""`DemoFolder.extend` closes a shard when it reaches this many demonstrations or states."""


class DemoFolder:
    """A dataset that grows shard by shard. Each shard is on disk before the next one is begun."""

    def __init__(
        self,
        path: Path,
        info: StateInfo,
        settings: DatasetSettings,
        *,
        upgrade: Callable[[DatasetSettings], DatasetSettings] = lambda saved: saved,
    ):
        """Open a new folder, or continue an existing one.

        Args:
            path: the folder.
            info: the meaning of the states.
            settings: what determines the content; recorded in the manifest.
            upgrade: converts settings that an earlier version saved to today's names.

        Raises:
            PlanspaceError: the folder cannot be written, or contains a dataset with other settings, or
                something else.
        """
        self.path = make_folder(path)
        self._manifest = Manifest(info, settings)
        if not (path / MANIFEST).exists():
            refuse_other_files(path, "demo dataset", OWN)
        else:
            found = read_manifest(path)
            saved, plain = upgrade(found.settings), json.loads(json.dumps(settings))
            if saved != plain:
                changed = "; ".join(list_differences(saved, plain))
                raise PlanspaceError(
                    f"{path} contains demonstrations made with other settings: {changed}. "
                    "Choose another --out, or give the same settings to continue it."
                )
            self._manifest = replace(found, info=info, settings=settings)
        if info.source is not None and not info.source.is_text:
            info.source.write(path / MODEL_FOLDER)

    @property
    def num_episodes(self) -> int:
        """Number of demonstrations on disk."""
        return sum(shard.episodes for shard in self._manifest.shards)

    @property
    def next_index(self) -> int:
        """The first demonstration that has not been attempted yet."""
        return self._manifest.next_index

    def append(self, episodes: Sequence[Episode], next_index: int) -> None:
        """Write episodes as one shard.

        Args:
            episodes: the demonstrations; may be empty if all attempts since the last call failed.
            next_index: the first demonstration that has not been attempted yet.
        """
        shards, tree_shards = self._manifest.shards, self._manifest.trees
        if episodes:
            arrays = join_episodes(self._manifest.info, episodes)
            trees = trees_of(episodes) if len(tree_shards) == len(shards) else ()
            if tree_shards and not trees:
                raise PlanspaceError(
                    f"{self.path} has search trees, so demonstrations without a tree cannot be added to it."
                )
            if trees:
                tree_shards = (*tree_shards, write_trees(self.path, len(shards), trees))
            shards = (*shards, write_shard(self.path, len(shards), arrays))
        self._manifest = replace(self._manifest, next_index=next_index, shards=shards, trees=tree_shards)
        write_manifest(self.path, self._manifest)

    def extend(self, episodes: Iterable[Episode]) -> None:
        """Write episodes as shards of limited size."""
        batch: list[Episode] = []
        num_states = 0
        for episode in episodes:
            batch.append(episode)
            num_states += len(episode.states)
            if len(batch) == SHARD_EPISODES or num_states >= SHARD_STATES:
                self.append(batch, self.num_episodes + len(batch))
                batch, num_states = [], 0
        if batch:
            self.append(batch, self.num_episodes + len(batch))


def remove_damaged_shards(folder: Path) -> list[tuple[Path, str]]:
    """Remove the first damaged shard and all later ones from the manifest.

    The command that made the dataset makes them again.

    Args:
        folder: the folder of the dataset.

    Returns:
        The path of the damaged shard and what is wrong with it; empty if all shards are intact.

    Raises:
        PlanspaceError: the manifest itself is damaged.
    """
    manifest = read_manifest(folder)
    next_index = 0
    for number, shard in enumerate(manifest.shards):
        name = shard.file if SHARD_NAME.fullmatch(shard.file) else shard_name(number)
        file = folder / name
        try:
            with reject_malformed(folder / MANIFEST):
                last = int(read_shard(folder, shard, manifest.info)["indices"][-1])
                if manifest.trees:
                    file = folder / FOLDER / shard_name(number)
                    read_trees(folder, manifest.trees[number], manifest.info)
                next_index = last + 1
        except PlanspaceError as error:
            kept = {"shards": manifest.shards[:number], "trees": manifest.trees[:number]}
            write_manifest(folder, replace(manifest, next_index=next_index, **kept))
            return [(file, str(error))]
    return []
