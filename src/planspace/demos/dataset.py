"""Demonstrations in memory, their arrays laid end to end."""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, UInt8

from planspace.demos.episode import Episode, join_episodes, trees_of
from planspace.demos.folder import DemoFolder
from planspace.demos.manifest import DatasetSettings
from planspace.demos.search_tree import SearchTree, join_trees
from planspace.demos.splits import Splits, complete_splits
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError
from planspace.storage.json_files import json_hash
from planspace.storage.runs import lock_folder
from planspace.summary import html_summary, text_summary

if TYPE_CHECKING:
    from planspace.physics.pictures import PictureConfig

MAX_NAMES = 8
"""Number of states that a summary lists by name."""
SPLIT_FRACTIONS = {"train": 0.8, "validation": 0.1}
"""Fraction of the demonstrations in each split; the rest is the test split."""


@dataclass(frozen=True, repr=False)
class Demos:
    """Demonstrations in memory."""

    info: StateInfo
    """The meaning of the states."""
    states: Float[np.ndarray, "row state"]
    """All states; episode i is rows offsets[i] : offsets[i + 1]."""
    controls: Float[np.ndarray, "step control"]
    """All controls; episode i is rows offsets[i] - i : offsets[i + 1] - i - 1."""
    times: Float[np.ndarray, " row"]
    """Time of each state [s], starting at 0 in each episode."""
    offsets: Int[np.ndarray, " bound"]
    """First row of each episode; the last entry is the number of rows."""
    goals: Float[np.ndarray, "demo state"]
    """Goal of each episode; see `Episode`."""
    success: np.ndarray
    """Whether each episode ends at its goal."""
    indices: Int[np.ndarray, " demo"]
    """Number of each episode in the order of planning or recording."""
    seeds: Int[np.ndarray, " demo"]
    """Successful attempt of each episode; see `Episode`."""
    costs: Float[np.ndarray, " demo"]
    """Planning cost of each episode [s]; NaN if unknown."""
    trees: tuple[SearchTree, ...] = ()
    """Search tree of each episode, if they were kept; otherwise empty."""
    splits: Splits = field(default_factory=dict)
    """Demonstrations in each split, if the source says it; otherwise empty, and `split` draws them."""

    def __len__(self) -> int:
        """Number of demonstrations."""
        return len(self.offsets) - 1

    def __repr__(self) -> str:
        return text_summary(*self._summary())

    def _repr_html_(self) -> str:
        return html_summary(*self._summary())

    def _summary(self) -> tuple[str, dict[str, str]]:
        info, durations = self.info, self.times[self.offsets[1:] - 1]
        names = [f"{n} [{u}]" if u else n for n, u in zip(info.names, info.units, strict=True)]
        if len(names) > MAX_NAMES:
            names = [*names[:MAX_NAMES], f"... ({len(info.names)} in all)"]
        median = np.median(durations)
        title = f"Demos: {len(self)} demonstrations" + (f" of {info.problem}" if info.problem else "")
        trees = {"search trees": f"{sum(map(len, self.trees))} nodes"} if self.trees else {}
        return title, {
            "states": f"{len(self.states)}, each ({', '.join(names)})",
            "controls": f"{info.num_controls} per step",
            "durations": f"{durations.min():.3g} to {durations.max():.3g} s (median {median:.3g} s)",
            "at the goal": f"{int(self.success.sum())} of {len(self)}",
            **trees,
        }

    @classmethod
    def from_episodes(cls, info: StateInfo, episodes: Sequence[Episode]) -> "Demos":
        """Join episodes into one dataset.

        Args:
            info: the meaning of the states.
            episodes: at least one episode.

        Raises:
            PlanspaceError: there are no episodes, sizes differ, or a number is not finite (the message names
                the row).
        """
        return cls(info=info, **join_episodes(info, episodes), trees=trees_of(episodes), splits={})

    def save(self, folder: str | Path) -> None:
        """Save as a dataset folder, which `load_demos` reads.

        Saving the same demonstrations again changes nothing. An interrupted save continues.

        Args:
            folder: the folder to make.

        Raises:
            PlanspaceError: the folder cannot be written, or contains other demonstrations.
        """
        settings = DatasetSettings(problem=self.info.problem, content=self.hash)
        if self.splits:
            settings["split"] = {name: list(places) for name, places in self.splits.items()}
        with lock_folder(Path(folder)):
            target = DemoFolder(Path(folder), self.info, settings)
            if target.num_episodes:
                self._check_same_episodes(Path(folder))
            target.extend(self.episode(i) for i in range(target.num_episodes, len(self)))

    def _check_same_episodes(self, folder: Path) -> None:
        """Check the fields of a dataset that the hash does not cover.

        Raises:
            PlanspaceError: it says something else.
        """
        from planspace.demos.load import load_demos

        saved = load_demos(folder)
        for name in ("success", "costs", "seeds", "indices"):
            if not np.array_equal(
                getattr(saved, name), getattr(self, name)[: len(saved)], equal_nan=name == "costs"
            ):
                raise PlanspaceError(
                    f"{folder} contains the same demonstrations with other {name}: choose another folder."
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
            tree=self.trees[i] if self.trees else None,
        )

    def select(self, names: Sequence[str]) -> "Demos":
        """The same demonstrations with some of their states.

        A model needs all of its states, so a proper selection has no model.

        Args:
            names: the states to keep, in the wanted order.

        Raises:
            PlanspaceError: a state does not exist, or is named twice.
        """
        if tuple(names) == self.info.names:
            return self
        missing = [name for name in names if name not in self.info.names]
        if missing or not names or len(set(names)) < len(names):
            raise PlanspaceError(
                f"cannot select the {len(names)} states ({', '.join(names)}) of demonstrations with the "
                f"{len(self.info.names)} states ({', '.join(self.info.names)}): "
                + (f"{missing[0]!r} is missing." if missing else "name at least one, each only once.")
            )
        columns = [self.info.names.index(name) for name in names]
        info = self.info.choose(tuple(names), columns)
        return replace(
            self,
            info=info,
            states=self.states[:, columns],
            goals=self.goals[:, columns],
            trees=tuple(tree.select(columns) for tree in self.trees),
        )

    def rows(self, episodes: Int[np.ndarray, " demo"]) -> Int[np.ndarray, " row"]:
        """Row numbers of some demonstrations, in order."""
        return np.concatenate([np.arange(int(self.offsets[i]), int(self.offsets[i + 1])) for i in episodes])

    def render_states(
        self,
        rows: Int[np.ndarray, " picture"] | None = None,
        config: "PictureConfig | None" = None,
        seed: int = 0,
    ) -> UInt8[np.ndarray, "picture height width 3"]:
        """Draw states as small pictures.

        Args:
            rows: the rows of `states` to draw; None for all. `config.frames` plays no role.
            config: size, camera, and how much colours and camera vary; None for 64 x 64 pixels as the model
                looks.
            seed: seed of colours and camera, which are drawn anew for each picture.

        Raises:
            PlanspaceError: there is no model, a row does not exist, or no OpenGL backend works here; the
                message says what to install.
        """
        from planspace.demos.render_states import render_states

        return render_states(self, rows, config, seed)

    @property
    def hash(self) -> str:
        """SHA-256 of the content. It does not depend on how a stored dataset is divided into shards."""
        return content_hash(self.info, lambda name: [getattr(self, name)], self.trees)

    def split(self, seed: int) -> dict[str, np.ndarray]:
        """Split into `train`, `validation` and `test`: as `splits` says, otherwise at random, see `split`."""
        return complete_splits(self.splits, seed) if self.splits else split(len(self), seed)


def split(count: int, seed: int) -> dict[str, Int[np.ndarray, " demo"]]:
    """Split demonstrations at random: 80 % `train`, 10 % `validation`, 10 % `test`.

    Args:
        count: number of demonstrations.
        seed: seed of the split.

    Returns:
        The numbers of the demonstrations in each split, sorted.

    Raises:
        PlanspaceError: there are fewer than 3 demonstrations.
    """
    if count < 3:
        raise PlanspaceError(
            f"a split into training, validation and test needs at least 3 demonstrations, got {count}."
        )
    held_out = max(1, round(SPLIT_FRACTIONS["validation"] * count))
    order = np.random.default_rng(np.random.SeedSequence([seed, count])).permutation(count)
    parts = np.split(order, [count - 2 * held_out, count - held_out])
    names = ("train", "validation", "test")
    return {name: np.sort(part) for name, part in zip(names, parts, strict=True)}


def content_hash(
    info: StateInfo, parts: Callable[[str], Iterable[np.ndarray]], trees: Iterable[SearchTree] = ()
) -> str:
    """SHA-256 of demonstrations.

    Args:
        info: the meaning of the states.
        parts: returns an array, given its name, as consecutive parts of any length.
        trees: the search trees, if there are any.
    """
    digest = hashlib.sha256(json_hash(info.plain()).encode())
    for name in ("states", "controls", "times", "offsets", "goals"):
        for part in parts(name):
            digest.update(np.ascontiguousarray(part, dtype=int if name == "offsets" else float).data)
    for tree in trees:
        for array in join_trees([tree]).values():
            digest.update(np.ascontiguousarray(array, dtype=float).data)
    return digest.hexdigest()
