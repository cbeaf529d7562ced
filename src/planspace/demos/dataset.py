"""Demonstrations in memory: ragged trajectories laid end to end, and what their numbers are.

An episode has T + 1 states and times and T controls: control k is held from state k to state k + 1.
"""

import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Int

from planspace.errors import PlanspaceError
from planspace.mjcf.compile import load_model
from planspace.physics.space import StateSpace
from planspace.storage.json_files import json_hash

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
            check_episode(info, episode)
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
        return content_hash(self.info, lambda name: [getattr(self, name)])

    def split(self, seed: int) -> dict[str, np.ndarray]:
        """Whole demonstrations, 80/10/10, as `train`, `validation`, `test`; raises if there are not 3."""
        return split(len(self), seed)


def split(count: int, seed: int) -> dict[str, Int[np.ndarray, " demo"]]:
    """Splits demonstrations 80/10/10 into `train`, `validation` and `test`, by whole episodes.

    Args:
        count: how many there are.
        seed: of the split.

    Raises:
        PlanspaceError: there are too few for three splits.
    """
    if count < 3:
        raise PlanspaceError(f"{count} demonstrations cannot be split in three; at least 3 are needed.")
    held_out = max(1, round(SPLIT_SHARES["validation"] * count))
    order = np.random.default_rng(np.random.SeedSequence([seed, count])).permutation(count)
    parts = np.split(order, [count - 2 * held_out, count - held_out])
    names = ("train", "validation", "test")
    return {name: np.sort(part) for name, part in zip(names, parts, strict=True)}


def content_hash(info: StateInfo, parts: Callable[[str], Iterable[np.ndarray]]) -> str:
    """SHA-256 of demonstrations.

    Args:
        info: what their states are.
        parts: an array by its name, in parts that lie end to end, wherever they are cut.
    """
    digest = hashlib.sha256(json_hash(asdict(info)).encode())
    for name in ("states", "controls", "times", "offsets", "goals"):
        for part in parts(name):
            digest.update(np.ascontiguousarray(part, dtype=int if name == "offsets" else float).data)
    return digest.hexdigest()


def check_info(info: StateInfo) -> None:
    """Sees that what a file says of states fits together.

    Raises:
        TypeError: something in it is of another kind.
        ValueError: it does not fit together.
    """
    lists = (info.names, info.units, info.joints, info.circular_columns, info.quaternion_columns)
    if not all(isinstance(values, tuple) for values in lists) or type(info.kinematic) is not bool:
        raise TypeError("what it says of the states is of the wrong kinds")
    size = len(info.names)
    texts = (*info.names, *info.units, *info.joints, info.problem, info.mjcf)
    numbers = (*info.circular_columns, *info.quaternion_columns, info.num_controls)
    if not all(isinstance(text, str) for text in texts) or not all(type(n) is int for n in numbers):
        raise TypeError("what it says of the states is of the wrong kinds")
    columns = (*info.circular_columns, *(first + k for first in info.quaternion_columns for k in range(4)))
    if not size or len(info.units) != size or not all(0 <= column < size for column in columns):
        raise ValueError("what it says of the states does not fit together")
    if info.num_controls < 0:
        raise ValueError(f"it has {info.num_controls} controls")


def check_episode(info: StateInfo, episode: Episode) -> None:
    """Refuses an episode that is none.

    Raises:
        PlanspaceError: its arrays do not fit together or with `info`, or a number is not finite (the place is
            named).
    """
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
