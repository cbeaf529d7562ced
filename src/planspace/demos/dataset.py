"""Datasets of demonstrations: ragged trajectories in immutable shards, under one sealed manifest.

    DIR/manifest.json              what the states mean, the model, and each shard with its SHA-256
    DIR/shard-00000.safetensors    some episodes, their arrays laid end to end
    DIR/log.jsonl                  dates and wall times, outside every hash

An episode has T + 1 states and times and T controls: control k is held from state k to state k + 1.
"""

import hashlib
import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Int

from planspace.errors import PlanspaceError
from planspace.physics.simulate import load_model
from planspace.physics.space import StateSpace
from planspace.store import (
    differences,
    json_hash,
    make_folder,
    read_arrays,
    read_described,
    refusing_nonsense,
    write_arrays,
    write_sealed,
)

SCHEMA = 1
MANIFEST = "manifest.json"
MINARI_PREFIX = "minari:"
ARRAYS = ("states", "controls", "times", "offsets", "goals", "success", "indices", "seeds", "costs")
"""What a shard holds."""
SPLIT_SHARES = {"train": 0.8, "validation": 0.1}
"""Shares of the demonstrations; the rest is the test split."""


@dataclass(frozen=True)
class StateInfo:
    """What the numbers of a state and of a control are, and the model they belong to."""

    names: tuple[str, ...]
    """A name for each number of a state."""
    units: tuple[str, ...]
    """The unit of each; empty text where it is not known."""
    circular_columns: tuple[int, ...]
    """Which numbers are angles on a circle [rad]."""
    num_controls: int
    """Numbers in a control."""
    problem: str = ""
    """The planning problem, where there is one."""
    joints: tuple[str, ...] = ()
    """The model's joints that make the state, where there is a model."""
    mjcf: str = ""
    """The whole model, where there is one."""
    quaternion_columns: tuple[int, ...] = ()
    """Where in a state each quaternion (w, x, y, z) begins."""
    kinematic: bool = False
    """Whether states are positions alone, and controls velocities."""

    @classmethod
    def of_model(cls, model: mujoco.MjModel, space: StateSpace, **known: Any) -> "StateInfo":
        """What a model and its state space say; `known` are the other fields."""
        return cls(
            names=space.names,
            units=space.units,
            circular_columns=space.circular_columns,
            num_controls=space.num_dofs if space.kinematic else model.nu,
            quaternion_columns=space.quaternion_columns,
            kinematic=space.kinematic,
            **known,
        )

    def compile(self) -> tuple[mujoco.MjModel, StateSpace]:
        """Compiles the model and reads its state space.

        Raises:
            PlanspaceError: there is no model, or it does not compile.
        """
        if not self.mjcf:
            raise PlanspaceError("the dataset has no model; import it with --problem.")
        model = load_model(self.mjcf)
        return model, StateSpace.from_model(model, self.joints, kinematic=self.kinematic)


@dataclass(frozen=True)
class Episode:
    """One demonstration."""

    states: Float[np.ndarray, "time state"]
    """T + 1 states; angles continuous, ending in (-pi, pi]."""
    controls: Float[np.ndarray, "step control"]
    """T controls, each held until the next state."""
    times: Float[np.ndarray, " time"]
    """When each state was reached [s], from 0."""
    goal: Float[np.ndarray, " state"]
    """Where it was to end; NaN where that is not known."""
    success: bool
    """Whether it ended there."""
    index: int
    """Its number in the order of planning or recording."""
    seed: int
    """The attempt that made it: failed attempts are retried with the next seed."""
    cost: float = math.nan
    """What the planner minimised [s]; NaN where nothing is known of it."""


@dataclass(frozen=True)
class Demos:
    """Demonstrations in memory, their states laid end to end."""

    info: StateInfo
    states: Float[np.ndarray, "row state"]
    """All states; episode i is rows offsets[i] : offsets[i + 1]."""
    controls: Float[np.ndarray, "step control"]
    """All controls; episode i is rows offsets[i] - i : offsets[i + 1] - i - 1."""
    times: Float[np.ndarray, " row"]
    offsets: Int[np.ndarray, " bound"]
    goals: Float[np.ndarray, "demo state"]
    success: np.ndarray
    indices: Int[np.ndarray, " demo"]
    seeds: Int[np.ndarray, " demo"]
    costs: Float[np.ndarray, " demo"]

    def __len__(self) -> int:
        """How many demonstrations."""
        return len(self.offsets) - 1

    @classmethod
    def from_episodes(cls, info: StateInfo, episodes: Sequence[Episode]) -> "Demos":
        """Lays episodes end to end.

        Raises:
            PlanspaceError: there are none, sizes differ, or a number is not finite (the place is named).
        """
        if not episodes:
            raise PlanspaceError("there are no demonstrations.")
        for episode in episodes:
            _check_episode(info, episode)
        lengths = [len(e.states) for e in episodes]
        return cls(
            info=info,
            states=np.concatenate([e.states for e in episodes]),
            controls=np.concatenate([e.controls for e in episodes]),
            times=np.concatenate([e.times for e in episodes]),
            offsets=np.concatenate([[0], np.cumsum(lengths)]),
            goals=np.stack([e.goal for e in episodes]),
            success=np.array([e.success for e in episodes]),
            indices=np.array([e.index for e in episodes]),
            seeds=np.array([e.seed for e in episodes]),
            costs=np.array([e.cost for e in episodes], dtype=float),
        )

    def episode(self, i: int) -> Episode:
        """Demonstration i."""
        a, b = int(self.offsets[i]), int(self.offsets[i + 1])
        return Episode(
            states=self.states[a:b],
            controls=self.controls[a - i : b - i - 1],
            times=self.times[a:b],
            goal=self.goals[i],
            success=bool(self.success[i]),
            index=int(self.indices[i]),
            seed=int(self.seeds[i]),
            cost=float(self.costs[i]),
        )

    def select(self, names: Sequence[str]) -> "Demos":
        """The same demonstrations with the named states alone, in that order.

        A model belongs to all of its states, so a true selection has none.

        Raises:
            PlanspaceError: there is no such state, or one is asked for twice.
        """
        if tuple(names) == self.info.names:
            return self
        missing = [name for name in names if name not in self.info.names]
        if missing or not names or len(set(names)) < len(names):
            raise PlanspaceError(
                f"the states ({', '.join(names)}), {len(names)} numbers, are asked for, the demonstrations "
                f"have ({', '.join(self.info.names)}), {len(self.info.names)} numbers"
                + (f": {missing[0]!r} is missing." if missing else "; name each of some of them once.")
            )
        columns = [self.info.names.index(name) for name in names]
        circular, quaternions = self.info.circular_columns, self.info.quaternion_columns
        info = replace(
            self.info,
            names=tuple(names),
            units=tuple(self.info.units[c] for c in columns),
            circular_columns=tuple(new for new, c in enumerate(columns) if c in circular),
            quaternion_columns=tuple(
                new
                for new, c in enumerate(columns)
                if c in quaternions and columns[new : new + 4] == [c, c + 1, c + 2, c + 3]
            ),
            joints=(),
            mjcf="",
        )
        return replace(self, info=info, states=self.states[:, columns], goals=self.goals[:, columns])

    def rows(self, episodes: Int[np.ndarray, " demo"]) -> Int[np.ndarray, " row"]:
        """The rows of some demonstrations, in order."""
        return np.concatenate([np.arange(int(self.offsets[i]), int(self.offsets[i + 1])) for i in episodes])

    @property
    def hash(self) -> str:
        """SHA-256 of the content, however it is cut into shards."""
        digest = hashlib.sha256(json_hash(asdict(self.info)).encode())
        for array in (self.states, self.controls, self.times, self.offsets, self.goals):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def split(self, seed: int) -> dict[str, np.ndarray]:
        """Splits the demonstrations 80/10/10 into `train`, `validation` and `test`, by whole episodes.

        Raises:
            PlanspaceError: there are too few for three splits.
        """
        count = len(self)
        if count < 3:
            raise PlanspaceError(f"{count} demonstrations cannot be split in three; at least 3 are needed.")
        held_out = max(1, round(SPLIT_SHARES["validation"] * count))
        order = np.random.default_rng(np.random.SeedSequence([seed, count])).permutation(count)
        parts = np.split(order, [count - 2 * held_out, count - held_out])
        return {
            name: np.sort(part) for name, part in zip(("train", "validation", "test"), parts, strict=True)
        }


class DemoFolder:
    """A dataset on disk that grows shard by shard; each shard is on disk before the next is begun."""

    def __init__(self, path: Path, info: StateInfo, settings: dict[str, Any]):
        """Opens a folder, new or to be continued.

        Args:
            path: the folder.
            info: what the states are.
            settings: what decides the content (problem hash, seed, planner); kept in the manifest.

        Raises:
            PlanspaceError: it cannot be written, or holds a dataset made with other settings.
        """
        self.path = make_folder(path)
        self._info, self._settings = info, settings
        self.shards: list[dict[str, Any]] = []
        self.next_index = 0
        if (path / MANIFEST).exists():
            manifest, _ = _described(path)
            if manifest["settings"] != json.loads(json.dumps(settings)):
                was = "; ".join(differences(manifest["settings"], settings))
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
            name = f"shard-{len(self.shards):05d}.safetensors"
            sha256 = write_arrays(self.path / name, _arrays(demos))
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
    path = Path(path)
    manifest, info = _described(path)
    with refusing_nonsense(path / MANIFEST):
        parts = [_read_shard(path, shard, info) for shard in manifest["shards"]]
    if not parts:
        raise PlanspaceError(f"{path} holds no demonstrations.")
    lengths = np.concatenate([np.diff(part["offsets"]) for part in parts])
    return Demos(
        info=info,
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        **{key: np.concatenate([part[key] for part in parts]) for key in ARRAYS if key != "offsets"},
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
        try:
            with refusing_nonsense(path / MANIFEST):
                next_index = int(_read_shard(path, shard, info)["indices"][-1]) + 1
        except PlanspaceError as error:
            kept = {"shards": manifest["shards"][:number], "next_index": next_index}
            write_sealed(path / MANIFEST, {**manifest, **kept})
            return [(path / Path(str(shard["file"])).name, str(error))]
    return []


def _described(path: Path) -> tuple[dict[str, Any], StateInfo]:
    """A dataset's manifest, and what it says of the states."""
    manifest = _read_manifest(path)
    with refusing_nonsense(path / MANIFEST):
        known: dict[str, Any] = {f.name: manifest["info"][f.name] for f in fields(StateInfo)}
        known = {key: tuple(value) if isinstance(value, list) else value for key, value in known.items()}
        info = StateInfo(**known)
        _check_info(info)
        _ = manifest["settings"], int(manifest["next_index"])
        _ = [(shard["file"], shard["sha256"], int(shard["episodes"])) for shard in manifest["shards"]]
    return manifest, info


def _read_shard(path: Path, shard: dict[str, Any], info: StateInfo) -> dict[str, np.ndarray]:
    """Reads and verifies a shard of which the manifest says this."""
    if not re.fullmatch(r"shard-\d{5,9}\.safetensors", str(shard["file"])):
        raise ValueError(f"{shard['file']!r} is no name of a shard")
    file = path / shard["file"]
    arrays = read_arrays(file, sha256=str(shard["sha256"]))
    with refusing_nonsense(file):
        _check_arrays(arrays, shard, info)
    return arrays


def _check_info(info: StateInfo) -> None:
    size, angles = len(info.names), (*info.circular_columns, *info.quaternion_columns)
    texts = (*info.names, *info.units, *info.joints, info.problem, info.mjcf)
    numbers = (*angles, info.num_controls)
    if not all(isinstance(text, str) for text in texts) or not all(type(n) is int for n in numbers):
        raise TypeError("what it says of the states is of the wrong kinds")
    if not size or len(info.units) != size or not all(0 <= column < size for column in angles):
        raise ValueError("what it says of the states does not fit together")


def _check_arrays(arrays: dict[str, np.ndarray], shard: dict[str, Any], info: StateInfo) -> None:
    num, rows = int(shard["episodes"]), int(shard["states"])
    shapes = {
        "states": (rows, len(info.names)),
        "controls": (rows - num, info.num_controls),
        "times": (rows,),
        "offsets": (num + 1,),
        "goals": (num, len(info.names)),
        **dict.fromkeys(("success", "indices", "seeds", "costs"), (num,)),
    }
    for name, shape in shapes.items():
        kind = {"offsets": "i", "indices": "i", "seeds": "i", "success": "b"}.get(name, "f")
        if arrays[name].shape != shape or arrays[name].dtype.kind != kind:
            raise ValueError(f"{name} has shape {arrays[name].shape} and type {arrays[name].dtype}")
    offsets = arrays["offsets"]
    if offsets[0] != 0 or offsets[-1] != rows or not (np.diff(offsets) > 0).all():
        raise ValueError("its demonstrations do not lie end to end")
    for name in ("states", "controls", "times"):
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} holds a number that is not finite")


def _read_manifest(path: Path) -> dict[str, Any]:
    file = path / MANIFEST
    if not file.exists():
        raise PlanspaceError(f"{path} is not a demo dataset: it has no {MANIFEST}.")
    return read_described(file, kind="demos", schema=SCHEMA, name="demo dataset")


def _arrays(demos: Demos) -> dict[str, np.ndarray]:
    return {name: getattr(demos, name) for name in ARRAYS}


def _check_episode(info: StateInfo, episode: Episode) -> None:
    where = f"demonstration {episode.index}"
    num_states, size = episode.states.shape
    if size != len(info.names) or episode.controls.shape[1] != info.num_controls:
        raise PlanspaceError(
            f"{where} has {size} numbers a state and {episode.controls.shape[1]} a control; "
            f"{len(info.names)} and {info.num_controls} were expected."
        )
    if len(episode.controls) != num_states - 1 or len(episode.times) != num_states:
        raise PlanspaceError(
            f"{where} has {num_states} states, {len(episode.controls)} controls and {len(episode.times)} "
            "times; T + 1, T and T + 1 were expected."
        )
    for name, array in (("state", episode.states), ("control", episode.controls), ("time", episode.times)):
        bad = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
        if len(bad):
            raise PlanspaceError(f"{where} holds a {name} that is not finite, in row {bad[0]}.")
