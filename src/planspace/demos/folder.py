"""A dataset on disk: immutable shards under one sealed manifest, read and grown a shard at a time.

DIR/manifest.json              what the states mean, the model, and each shard with its SHA-256
DIR/shard-00000.safetensors    some episodes, their arrays laid end to end
DIR/log.jsonl                  dates and wall times, outside every hash
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos, Episode, StateInfo, check_info, content_hash, split
from planspace.errors import PlanspaceError
from planspace.storage.arrays import read_array, read_arrays, write_arrays
from planspace.storage.checks import check_file, damage_error, explain_memory_error, reject_malformed
from planspace.storage.files import make_folder
from planspace.storage.json_files import read_description, write_sealed
from planspace.storage.settings import list_differences

SCHEMA = 1
MANIFEST = "manifest.json"
MINARI_PREFIX = "minari:"
MOST = 2**48
"""No shard has so many states."""
HEADER_BYTES = 1 << 16
"""What a shard has beside its numbers, at most."""
SHARD_NAME = re.compile(r"shard-\d{5,9}\.safetensors")
ARRAYS = ("states", "controls", "times", "offsets", "goals", "success", "indices", "seeds", "costs")
"""What a shard holds."""


def load_demos(path: str | Path) -> Demos:
    """Reads a dataset and verifies every shard.

    Args:
        path: its folder; or `minari:ID`, a dataset that Minari has on this machine.

    Raises:
        PlanspaceError: no dataset, a newer schema, or a missing or altered shard (which is named).
    """
    if str(path).startswith(MINARI_PREFIX):
        from planspace.demos.convert import minari_demos  # which stands on this module

        return minari_demos(str(path))
    return StoredDemos(Path(path)).load()


class StoredDemos:
    """A dataset on disk, of which one shard at a time is in memory."""

    def __init__(self, path: str | Path):
        """Opens a dataset.

        Args:
            path: its folder.

        Raises:
            PlanspaceError: it is none, holds no demonstrations, is damaged, or of a newer schema.
        """
        self.path, self._verified = Path(path), False
        manifest, self.info = _described(self.path)
        self.settings: dict[str, Any] = manifest["settings"]
        self._shards: list[dict[str, Any]] = manifest["shards"]
        if not self._shards:
            raise PlanspaceError(f"{path} holds no demonstrations.")

    def __len__(self) -> int:
        """How many demonstrations."""
        return sum(shard["episodes"] for shard in self._shards)

    def shards(self) -> Iterator[Demos]:
        """The demonstrations of each shard in turn, verified.

        Raises:
            PlanspaceError: a shard is missing or altered (it is named).
        """
        for shard in self._shards:
            yield Demos(info=self.info, **self._read(shard))
        self._verified = True

    def episodes(self) -> Iterator[Episode]:
        """The demonstrations in turn; raises as `shards()`."""
        for part in self.shards():
            yield from (part.episode(i) for i in range(len(part)))

    def load(self) -> Demos:
        """All of it.

        Raises:
            PlanspaceError: a shard is missing or altered (it is named).
        """
        with explain_memory_error(self.path):
            parts = [self._read(shard) for shard in self._shards]
            offsets = _end_to_end([part.pop("offsets") for part in parts])
            names = [name for name in ARRAYS if name != "offsets"]
            whole = {name: np.concatenate([part.pop(name) for part in parts]) for name in names}
            return Demos(info=self.info, offsets=offsets, **whole)

    @cached_property
    def offsets(self) -> Int[np.ndarray, " bound"]:
        """Where each demonstration begins among all states; the last number is where they end."""
        self._verify()
        return _end_to_end(list(self._each("offsets")))

    @property
    def hash(self) -> str:
        """SHA-256 of the content, the same as of `load()`; raises as `shards()`."""
        self._verify()
        return content_hash(self.info, lambda name: [self.offsets] if name == "offsets" else self._each(name))

    def split(self, seed: int) -> dict[str, Int[np.ndarray, " demo"]]:
        """Whole demonstrations, 80/10/10, as `train`, `validation`, `test`; raises if there are not 3."""
        return split(len(self), seed)

    def states_at(self, rows: Int[np.ndarray, "*any"]) -> Float[np.ndarray, "*any state"]:
        """The states of some rows, such as `random_triplets` draws; as `load().states[rows]`.

        Every shard that one of them lies in is read: draw many at a time.

        Args:
            rows: numbers of states, from 0, those of all shards laid end to end.

        Raises:
            PlanspaceError: there is no such row, or a shard is missing or altered (it is named).
        """
        num_states = sum(shard["states"] for shard in self._shards)
        if rows.size and not (rows.min() >= 0 and rows.max() < num_states):
            raise PlanspaceError(
                f"rows {rows.min()} to {rows.max()} are asked for; {self.path} has 0 to {num_states - 1}."
            )
        states = np.empty((*rows.shape, len(self.info.names)))
        first = 0
        for shard in self._shards:
            here = (rows >= first) & (rows < first + shard["states"])
            if here.any():
                states[here] = self._read(shard)["states"][rows[here] - first]
            first += shard["states"]
        return states

    def _read(self, shard: dict[str, Any]) -> dict[str, np.ndarray]:
        with reject_malformed(self.path / MANIFEST):
            return _read_shard(self.path, shard, self.info)

    def _verify(self) -> None:
        if not self._verified:
            for _ in self.shards():
                pass

    def _each(self, name: str) -> Iterator[np.ndarray]:
        with reject_malformed(self.path / MANIFEST):
            files = [_shard_file(self.path, shard) for shard in self._shards]
        return (read_array(file, name) for file in files)


class DemoFolder:
    """A dataset on disk that grows shard by shard; each shard is on disk before the next is begun."""

    def __init__(
        self,
        path: Path,
        info: StateInfo,
        settings: dict[str, Any],
        *,
        upgrade: Callable[[dict[str, Any]], dict[str, Any]] = dict,
    ):
        """Opens a folder, new or to be continued.

        Args:
            path: the folder.
            info: what the states are.
            settings: what decides the content (problem hash, seed, planner); kept in the manifest.
            upgrade: converts settings that an earlier version saved to today's names.

        Raises:
            PlanspaceError: it cannot be written, or holds a dataset made with other settings.
        """
        self.path = make_folder(path)
        self._info, self._settings = info, settings
        self.shards: list[dict[str, Any]] = []
        self.next_index = 0
        if (path / MANIFEST).exists():
            manifest, _ = _described(path)
            saved = upgrade(manifest["settings"])
            if saved != json.loads(json.dumps(settings)):
                was = "; ".join(list_differences(saved, settings))
                raise PlanspaceError(f"{path} holds demonstrations made with other settings: {was}.")
            self.shards = manifest["shards"]
            self.next_index = manifest["next_index"]

    @property
    def num_episodes(self) -> int:
        """Episodes on disk."""
        return sum(shard["episodes"] for shard in self.shards)

    def append(self, episodes: Sequence[Episode], next_index: int) -> None:
        """Commits episodes as one shard.

        Args:
            episodes: may be empty, when every attempt of a stretch failed.
            next_index: the first index that has not been tried yet.
        """
        if episodes:
            demos = Demos.from_episodes(self._info, episodes)
            name = _shard_name(len(self.shards))
            sha256 = write_arrays(self.path / name, {key: getattr(demos, key) for key in ARRAYS})
            shard = {"file": name, "sha256": sha256, "episodes": len(demos), "states": len(demos.states)}
            self.shards = [*self.shards, shard]
        self.next_index = next_index
        write_sealed(
            self.path / MANIFEST,
            {
                "schema": SCHEMA,
                "kind": "demos",
                "info": asdict(self._info),
                "settings": self._settings,
                "next_index": next_index,
                "shards": self.shards,
            },
        )


def keep_whole_shards(path: Path) -> list[tuple[Path, str]]:
    """Leaves out the shards from the first damaged one on; the same command makes them again.

    Args:
        path: the dataset's folder.

    Returns:
        The damaged shard, which the manifest no longer names, and what is wrong with it.

    Raises:
        PlanspaceError: the manifest itself is damaged.
    """
    manifest, info = _described(path)
    next_index = 0
    for number, shard in enumerate(manifest["shards"]):
        name = str(shard["file"]) if SHARD_NAME.fullmatch(str(shard["file"])) else _shard_name(number)
        try:
            with reject_malformed(path / MANIFEST):
                next_index = int(_read_shard(path, shard, info)["indices"][-1]) + 1
        except PlanspaceError as error:
            kept = {"shards": manifest["shards"][:number], "next_index": next_index}
            write_sealed(path / MANIFEST, {**manifest, **kept})
            return [(path / name, str(error))]
    return []


def _described(path: Path) -> tuple[dict[str, Any], StateInfo]:
    """A dataset's manifest, and what it says of the states."""
    file = path / MANIFEST
    if not file.exists():
        raise PlanspaceError(f"{path} is not a demo dataset: it has no {MANIFEST}.")
    manifest = read_description(file, kind="demos", schema=SCHEMA)
    with reject_malformed(file):
        known: dict[str, Any] = {f.name: manifest["info"][f.name] for f in fields(StateInfo)}
        known = {key: tuple(value) if isinstance(value, list) else value for key, value in known.items()}
        info = StateInfo(**known)
        check_info(info)
        if not isinstance(manifest["settings"], dict) or type(manifest["next_index"]) is not int:
            raise TypeError("its settings or next_index are of the wrong kind")
        if not isinstance(manifest["shards"], list) or manifest["next_index"] < 0:
            raise ValueError("its shards are no list, or next_index is negative")
        files = [str(shard["file"]) for shard in manifest["shards"]]
        if len(set(files)) < len(files):
            raise ValueError("it names a shard twice")
        for shard in manifest["shards"]:
            _ = shard["sha256"]
            episodes, states = shard["episodes"], shard["states"]
            if type(episodes) is not int or type(states) is not int or not 0 < episodes <= states < MOST:
                raise ValueError(f"a shard of {episodes} demonstrations and {states} states")
    return manifest, info


def _read_shard(path: Path, shard: dict[str, Any], info: StateInfo) -> dict[str, np.ndarray]:
    """Reads and verifies a shard of which the manifest says this."""
    file = _shard_file(path, shard)
    most = HEADER_BYTES + 8 * sum(math.prod(shape) for shape in _shapes(shard, info).values())
    check_file(file)
    if (size := file.stat().st_size) > most:
        raise damage_error(file, f"it has {size} bytes, its manifest says at most {most}")
    arrays = read_arrays(file, sha256=str(shard["sha256"]))
    with reject_malformed(file):
        _check_arrays(arrays, shard, info)
    return {name: arrays[name] for name in ARRAYS}


def _shard_file(path: Path, shard: dict[str, Any]) -> Path:
    if not SHARD_NAME.fullmatch(str(shard["file"])):
        raise ValueError(f"{shard['file']!r} is no name of a shard")
    return path / shard["file"]


def _shard_name(number: int) -> str:
    return f"shard-{number:05d}.safetensors"


def _shapes(shard: dict[str, Any], info: StateInfo) -> dict[str, tuple[int, ...]]:
    """The shapes that the arrays of a shard must have."""
    num, rows = int(shard["episodes"]), int(shard["states"])
    return {
        "states": (rows, len(info.names)),
        "controls": (rows - num, info.num_controls),
        "times": (rows,),
        "offsets": (num + 1,),
        "goals": (num, len(info.names)),
        **dict.fromkeys(("success", "indices", "seeds", "costs"), (num,)),
    }


def _check_arrays(arrays: dict[str, np.ndarray], shard: dict[str, Any], info: StateInfo) -> None:
    for name, shape in _shapes(shard, info).items():
        kind = {"offsets": "i", "indices": "i", "seeds": "i", "success": "b"}.get(name, "f")
        if arrays[name].shape != shape or arrays[name].dtype.kind != kind:
            raise ValueError(f"{name} has shape {arrays[name].shape} and type {arrays[name].dtype}")
    offsets = arrays["offsets"]
    if offsets[0] != 0 or offsets[-1] != shard["states"] or not (np.diff(offsets) > 0).all():
        raise ValueError("its demonstrations do not lie end to end")
    for name in ("states", "controls", "times"):
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} holds a number that is not finite")


def _end_to_end(offsets: Sequence[np.ndarray]) -> Int[np.ndarray, " bound"]:
    """The offsets of parts as those of the whole."""
    lengths = np.concatenate([np.diff(part) for part in offsets])
    return np.concatenate([[0], np.cumsum(lengths)])
