"""One demonstration, and the arrays of several laid end to end.

An episode has T + 1 states and times and T controls: control k is held from state k to state k + 1.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.search_tree import SearchTree
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError
from planspace.storage.arrays import Arrays


@dataclass(frozen=True)
class Origin:
    """Where the states of a demonstration were read, for messages."""

    file: str
    """The file."""
    word: str
    """What a row of the file is called: `line` or `row`."""
    starts: tuple[int, ...]
    """States at which a run of consecutive rows begins; the first is 0."""
    rows: tuple[int, ...]
    """Number of the row of each of these states."""

    @classmethod
    def of_rows(cls, file: str, word: str, rows: Int[np.ndarray, " time"]) -> "Origin":
        """Store the number of the row of each state, as runs of consecutive rows.

        Args:
            file: the file.
            word: what a row of the file is called.
            rows: number of the row of each state.
        """
        starts = np.flatnonzero(np.diff(rows, prepend=rows[:1] - 2) != 1)
        return cls(file, word, tuple(starts.tolist()), tuple(rows[starts].tolist()))

    def row(self, i: int) -> int:
        """Number of the row of state i."""
        run = bisect_right(self.starts, i) - 1
        return self.rows[run] + i - self.starts[run]

    def place(self, i: int) -> str:
        """Where state i is, such as `log.csv, line 17`."""
        return f"{self.file}, {self.word} {self.row(i)}"

    def take(self, states: Int[np.ndarray, " chosen"]) -> "Origin":
        """Where some of the states are."""
        return Origin.of_rows(self.file, self.word, np.array([self.row(i) for i in states.tolist()]))


@dataclass(frozen=True)
class Episode:
    """One demonstration."""

    states: Float[np.ndarray, "time state"]
    """T + 1 states; angles are continuous and end in (-pi, pi]."""
    controls: Float[np.ndarray, "step control"]
    """T controls, each held until the next state."""
    times: Float[np.ndarray, " time"]
    """Time of each state [s], starting at 0."""
    goal: Float[np.ndarray, " state"]
    """The goal state; NaN if unknown."""
    success: bool
    """Whether the demonstration ends at the goal."""
    index: int
    """Number of the demonstration in the order of planning or recording."""
    seed: int
    """The attempt that produced it: failed attempts are repeated with the next seed."""
    cost: float = math.nan
    """The cost that the planner minimised [s]; NaN if unknown."""
    tree: SearchTree | None = None
    """The tree of the search that found it, if it was kept. Node 0 is the first state."""
    origin: Origin | None = field(default=None, repr=False, compare=False)
    """Where it was read, while it is imported; not stored."""

    def place(self, i: int) -> str:
        """Where state i was read, for messages."""
        return self.origin.place(i) if self.origin else f"demonstration {self.index}, row {i}"


def join_episodes(info: StateInfo, episodes: Sequence[Episode]) -> Arrays:
    """Lay the arrays of episodes end to end.

    Args:
        info: the meaning of the states.
        episodes: at least one episode.

    Returns:
        The arrays of a `Demos`, by field name.

    Raises:
        PlanspaceError: there are no episodes, or `check_episode` rejects one.
    """
    if not episodes:
        raise PlanspaceError("there are no demonstrations.")
    for episode in episodes:
        check_episode(info, episode)
    lengths = [len(e.states) for e in episodes]
    return {
        "states": np.concatenate([e.states for e in episodes]),
        "controls": np.concatenate([e.controls for e in episodes]),
        "times": np.concatenate([e.times for e in episodes]),
        "offsets": np.concatenate([[0], np.cumsum(lengths)]),
        "goals": np.stack([e.goal for e in episodes]),
        "success": np.array([e.success for e in episodes]),
        "indices": np.array([e.index for e in episodes]),
        "seeds": np.array([e.seed for e in episodes]),
        "costs": np.array([e.cost for e in episodes], dtype=float),
    }


def trees_of(episodes: Sequence[Episode]) -> tuple[SearchTree, ...]:
    """The search trees of episodes; empty if one of them has none."""
    trees = tuple(episode.tree for episode in episodes if episode.tree is not None)
    return trees if len(trees) == len(episodes) else ()


def check_episode(info: StateInfo, episode: Episode) -> None:
    """Check the shapes and numbers of an episode.

    Raises:
        PlanspaceError: the arrays do not fit together or do not fit `info`, or a number is not finite. The
            message names the row.
    """
    where = f"demonstration {episode.index}"
    num_states, size = episode.states.shape
    if size != len(info.names) or episode.controls.shape[1] != info.num_controls:
        raise PlanspaceError(
            f"{where} has {size} numbers per state and {episode.controls.shape[1]} per control; expected "
            f"{len(info.names)} and {info.num_controls}."
        )
    if len(episode.controls) != num_states - 1 or len(episode.times) != num_states:
        raise PlanspaceError(
            f"{where} has {num_states} states, {len(episode.controls)} controls and {len(episode.times)} "
            "times; expected T + 1, T and T + 1."
        )
    controls = [f"control{i + 1}" for i in range(info.num_controls)]
    times = episode.times[:, None]
    for names, array in ((info.names, episode.states), (controls, episode.controls), (["the time"], times)):
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            row, column = bad[0].tolist()
            raise PlanspaceError(f"{where}, row {row}: {names[column]} is not finite.")
