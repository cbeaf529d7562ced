"""The search tree of a plan: feasible transitions of known duration, also where the plan does not go."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from planspace.storage.arrays import Arrays


@dataclass(frozen=True)
class SearchTree:
    """The states that a search reached from its start, and the edges between them.

    Node 0 is the start. A parent has a lower number than its children. The time from a node to any of its
    descendants is an upper bound on the shortest time between their states.
    """

    states: Float[np.ndarray, "node state"]
    """State of each node."""
    parents: Int[np.ndarray, " node"]
    """Parent of each node; -1 for node 0."""
    durations: Float[np.ndarray, " node"]
    """Time from the parent to each node [s]; 0 for node 0."""

    def __len__(self) -> int:
        """Number of nodes."""
        return len(self.parents)

    @cached_property
    def times(self) -> Float[np.ndarray, " node"]:
        """Time from node 0 to each node along the tree [s]."""
        times = self.durations.copy()
        for node, parent in enumerate(self.parents.tolist()):
            if parent >= 0:
                times[node] += times[parent]
        return times

    def path(self, node: int) -> Int[np.ndarray, " node"]:
        """The nodes from node 0 to a node."""
        path = [node]
        while (parent := int(self.parents[path[-1]])) >= 0:
            path.append(parent)
        return np.array(path[::-1])

    def keep(self, nodes: np.ndarray) -> "SearchTree":
        """The tree of some nodes and all of their ancestors.

        Args:
            nodes: numbers of nodes, or a mask.
        """
        kept = np.zeros(len(self), dtype=bool)
        kept[0] = kept[nodes] = True
        for node in range(len(self) - 1, 0, -1):
            if kept[node]:
                kept[self.parents[node]] = True
        return self._only(kept)

    def thin(self, most: int, rng: np.random.Generator) -> "SearchTree":
        """A tree of at most `most` nodes: random nodes, each with all of its ancestors.

        Args:
            most: largest number of nodes, at least 1.
            rng: decides the order in which nodes are taken, while there is room for them.
        """
        if len(self) <= most:
            return self
        kept, room = np.zeros(len(self), dtype=bool), most - 1
        kept[0] = True
        for node in rng.permutation(len(self)).tolist():
            missing = []
            while not kept[node]:
                missing.append(node)
                node = self.parents[node]
            if len(missing) <= room:
                kept[missing] = True
                room -= len(missing)
            if not room:
                break
        return self._only(kept)

    def select(self, columns: Sequence[int]) -> "SearchTree":
        """The same tree with some numbers of its states."""
        return replace(self, states=self.states[:, columns])

    def _only(self, kept: np.ndarray) -> "SearchTree":
        """The tree of the nodes in a mask that contains the ancestors of all of them."""
        number = np.cumsum(kept) - 1
        parents = np.where(self.parents[kept] < 0, -1, number[self.parents[kept]])
        return SearchTree(self.states[kept], parents, self.durations[kept])


def check_tree(tree: SearchTree, state_dim: int) -> None:
    """Check that arrays are a tree.

    Args:
        tree: the arrays.
        state_dim: how many numbers its states must have.

    Raises:
        ValueError: they are not; the message says why.
    """
    states, parents, durations = tree.states, tree.parents, tree.durations
    if parents.ndim != 1 or not len(parents) or parents.dtype.kind not in "iu":
        raise ValueError("the parents of a search tree must be a list of at least one integer")
    if states.shape != (len(parents), state_dim) or durations.shape != parents.shape:
        raise ValueError(
            f"a search tree of {len(parents)} nodes must have states of shape {(len(parents), state_dim)} "
            f"and durations of shape {parents.shape}, got {states.shape} and {durations.shape}"
        )
    if not (np.isfinite(states).all() and np.isfinite(durations).all()):
        raise ValueError("a search tree contains a number that is not finite")
    if parents[0] != -1 or (parents[1:] < 0).any() or (parents >= np.arange(len(parents))).any():
        raise ValueError("the parent of a node must have a lower number; only node 0 has the parent -1")
    if durations[0] != 0 or (durations[1:] <= 0).any():
        raise ValueError("the durations of a search tree must be positive; only that of node 0 is 0")


def as_tree(given: Any, state_dim: int) -> SearchTree:
    """A tree that someone handed over, with arrays of our types.

    Raises:
        ValueError: it is not a tree.
    """
    if not isinstance(given, SearchTree):
        raise ValueError(f"expected a SearchTree, got {type(given).__name__}")
    parents = np.asarray(given.parents)
    try:
        states, durations = np.asarray(given.states, dtype=float), np.asarray(given.durations, dtype=float)
    except (TypeError, ValueError):
        raise ValueError("the states and durations of a search tree must be numbers") from None
    tree = SearchTree(states, parents, durations)
    check_tree(tree, state_dim)
    return replace(tree, parents=parents.astype(np.int64))


def join_trees(trees: Sequence[SearchTree]) -> Arrays:
    """Lay the arrays of trees end to end; `split_trees` undoes it."""
    return {
        "states": np.concatenate([tree.states for tree in trees]),
        "parents": np.concatenate([tree.parents for tree in trees]),
        "durations": np.concatenate([tree.durations for tree in trees]),
        "offsets": np.concatenate([[0], np.cumsum([len(tree) for tree in trees])]),
    }


def split_trees(arrays: Arrays) -> tuple[SearchTree, ...]:
    """The trees whose arrays `join_trees` laid end to end."""
    cuts = arrays["offsets"][1:-1]
    parts = (np.split(arrays[name], cuts) for name in ("states", "parents", "durations"))
    return tuple(SearchTree(*part) for part in zip(*parts, strict=True))
