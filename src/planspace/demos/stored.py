"""Read a dataset on disk without loading all of it."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos, content_hash, split
from planspace.demos.episode import Episode
from planspace.demos.manifest import MANIFEST, Shard, read_manifest
from planspace.demos.search_tree import SearchTree
from planspace.demos.shards import ARRAYS, read_shard, shard_file
from planspace.demos.splits import Splits, check_splits, complete_splits
from planspace.demos.tree_shards import FOLDER, read_trees
from planspace.errors import PlanspaceError
from planspace.storage.arrays import Arrays, read_array
from planspace.storage.checks import explain_memory_error, reject_malformed
from planspace.storage.ready_made import PLANS, find_folder


class StoredDemos:
    """A dataset on disk that keeps one shard at a time in memory."""

    def __init__(self, path: str | Path):
        """Open a dataset.

        Args:
            path: the folder of the dataset, or the name of ready-made plans, such as `cartpole-swingup`.

        Raises:
            UsageError: neither a folder nor ready-made plans have this name.
            PlanspaceError: the folder is not a dataset, has no demonstrations, is damaged, or has a newer
                schema.
        """
        self.path, self._verified = find_folder(path, PLANS), False
        manifest = read_manifest(self.path)
        self.info, self.settings, self._shards = manifest.info, manifest.settings, manifest.shards
        self._tree_shards = manifest.trees
        if not self._shards:
            raise PlanspaceError(f"{path} has no demonstrations.")

    def __len__(self) -> int:
        """Number of demonstrations."""
        return sum(shard.episodes for shard in self._shards)

    def __repr__(self) -> str:
        return f"StoredDemos({str(self.path)!r}): {len(self)} demonstrations in {len(self._shards)} shards"

    @property
    def splits(self) -> Splits:
        """Demonstrations in each split, if the source says it."""
        with reject_malformed(self.path / MANIFEST):
            return check_splits(self.settings.get("split", {}), len(self))

    def shards(self) -> Iterator[Demos]:
        """The demonstrations of each shard in turn, verified.

        Raises:
            PlanspaceError: a shard is missing or was altered; the message names it.
        """
        for number, shard in enumerate(self._shards):
            arrays = self._read(shard)
            yield Demos(info=self.info, **arrays, trees=self._trees(number, arrays), splits={})
        self._verified = True

    def episodes(self) -> Iterator[Episode]:
        """The demonstrations in turn; raises the errors of `shards()`."""
        for part in self.shards():
            yield from (part.episode(i) for i in range(len(part)))

    def load(self) -> Demos:
        """Load the complete dataset.

        Raises:
            PlanspaceError: a shard is missing or was altered; the message names it.
        """
        with explain_memory_error(self.path):
            parts = [self._read(shard) for shard in self._shards]
            trees = [tree for number, part in enumerate(parts) for tree in self._trees(number, part)]
            offsets = _join_offsets([part.pop("offsets") for part in parts])
            names = [name for name in ARRAYS if name != "offsets"]
            whole = {name: np.concatenate([part.pop(name) for part in parts]) for name in names}
            trees = tuple(trees)
            return Demos(info=self.info, offsets=offsets, **whole, trees=trees, splits=self.splits)

    @property
    def num_nodes(self) -> int:
        """Number of nodes of all search trees; 0 if there are none."""
        return sum(shard.nodes for shard in self._tree_shards)

    @cached_property
    def offsets(self) -> Int[np.ndarray, " bound"]:
        """First row of each demonstration among all states; the last entry is the number of rows."""
        self._verify()
        return _join_offsets(list(self._each("offsets")))

    @property
    def hash(self) -> str:
        """SHA-256 of the content, equal to `load().hash`; raises the errors of `shards()`."""
        self._verify()
        trees = (tree for shard in self._tree_shards for tree in read_trees(self.path, shard, self.info))
        return content_hash(
            self.info, lambda name: [self.offsets] if name == "offsets" else self._each(name), trees
        )

    def split(self, seed: int) -> dict[str, Int[np.ndarray, " demo"]]:
        """Split into `train`, `validation` and `test`; see `Demos.split`."""
        return complete_splits(self.splits, seed) if self.splits else split(len(self), seed)

    def states_at(self, rows: Int[np.ndarray, "*any"]) -> Float[np.ndarray, "*any state"]:
        """The states at some rows, such as those of `random_triplets`; equal to `load().states[rows]`.

        Every shard that contains one of the rows is read, so request many rows at once.

        Args:
            rows: row numbers in all shards laid end to end, starting at 0.

        Raises:
            PlanspaceError: a row is out of range, or a shard is missing or was altered (the message names
                it).
        """
        num_states = sum(shard.states for shard in self._shards)
        if rows.size and not (rows.min() >= 0 and rows.max() < num_states):
            raise PlanspaceError(
                f"rows {rows.min()} to {rows.max()} are out of range; {self.path} has rows 0 to "
                f"{num_states - 1}."
            )
        states = np.empty((*rows.shape, len(self.info.names)))
        first = 0
        for shard in self._shards:
            here = (rows >= first) & (rows < first + shard.states)
            if here.any():
                states[here] = self._read(shard)["states"][rows[here] - first]
            first += shard.states
        return states

    def _read(self, shard: Shard) -> Arrays:
        with reject_malformed(self.path / MANIFEST):
            return read_shard(self.path, shard, self.info)

    def _trees(self, number: int, arrays: Arrays) -> tuple[SearchTree, ...]:
        """The search trees of a shard, given its other arrays."""
        if not self._tree_shards:
            return ()
        shard = self._tree_shards[number]
        trees = read_trees(self.path, shard, self.info)
        starts = arrays["states"][arrays["offsets"][:-1]]
        with reject_malformed(self.path / FOLDER / shard.file):
            if not np.array_equal(np.stack([tree.states[0] for tree in trees]), starts):
                raise ValueError("a search tree does not start where its demonstration starts")
        return trees

    def _verify(self) -> None:
        if not self._verified:
            for _ in self.shards():
                pass

    def _each(self, name: str) -> Iterator[np.ndarray]:
        files = [shard_file(self.path, shard) for shard in self._shards]
        return (read_array(file, name) for file in files)


def _join_offsets(offsets: Sequence[np.ndarray]) -> Int[np.ndarray, " bound"]:
    """The offsets of all shards as the offsets of one dataset."""
    lengths = np.concatenate([np.diff(part) for part in offsets])
    return np.concatenate([[0], np.cumsum(lengths)])
