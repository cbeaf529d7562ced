"""The tree of SST*: nodes as growing arrays, neighbour search, and witness cells."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from planspace.demos.search_tree import SearchTree
from planspace.physics.simulator import Simulator
from planspace.plan.features import Features
from planspace.tasks.problem import Problem

NEIGHBOURS = 8
"""Number of neighbours from which best-near selection chooses."""
NEIGHBOUR_SLACK = 2.0
"""Approximate search: a neighbour is at most 1 + this times as far away as the true one. With 2, the nearest
is 1 % too far on average, and in 14 dimensions the search takes 4 ms instead of 100 ms (512 targets among
23,000 nodes)."""


class Tree:
    """The nodes as growing arrays, and one representative for each witness cell."""

    def __init__(
        self, root: Float[np.ndarray, " state"], problem: Problem, simulator: Simulator, cell_size: float
    ):
        """Start a tree.

        Args:
            root: the state that the tree grows from.
            problem: provides the cost and the weights of the features.
            simulator: provides the state space and the number of threads.
            cell_size: side of a witness cell, in features.
        """
        self.problem, self.simulator, self.cell_size = problem, simulator, cell_size
        self.space = simulator.space
        self.states = root[None].copy()
        self.features_of = Features(problem, simulator)
        self.features = self.features_of(self.states)
        self.parents, self.durations, self.costs = np.array([-1]), np.array([0]), np.array([0.0])
        self.controls = np.zeros((1, len(simulator.control_low)))
        self.servos = np.array([False])
        self.sequences: dict[int, np.ndarray] = {}  # the controls of edges that servo, one per physics step
        self._hash = np.random.default_rng(0).integers(1, 1 << 62, self.features.shape[1]) * 2 + 1
        self._sort_into_cells()
        self.cells_per_edge = np.inf  # witness cells that the edges added last crossed, in the median
        self._indexed = 0
        self._old: cKDTree | None = None

    def select(self, targets: Float[np.ndarray, "batch feature"], radius: float) -> np.ndarray:
        """Best-near selection: the cheapest node within the radius of each target, else the nearest."""
        distances, nodes = self._neighbours(targets)
        for image in self.space.mirrored(targets):
            distances, nodes = _nearest(distances, nodes, *self._neighbours(image))
        nodes = self._winner[self._cell[nodes]]
        costs = np.where(distances <= radius, self.costs[nodes], np.inf)
        near = distances[:, 0] <= radius
        choice = np.where(near, costs.argmin(axis=1), 0)
        return nodes[np.arange(len(nodes)), choice]

    def representatives(self) -> np.ndarray:
        """The node of each witness cell from which the tree grows."""
        return self._winner

    def search_tree(self) -> SearchTree:
        """The representatives and their ancestors, with durations in seconds."""
        durations = self.durations * self.simulator.model.opt.timestep
        return SearchTree(self.states, self.parents, durations).keep(self.representatives())

    def add(
        self, parents: np.ndarray, controls: np.ndarray, durations: np.ndarray, states: np.ndarray
    ) -> np.ndarray:
        """Add the nodes that are the cheapest in their witness cell; return their numbers."""
        costs = self.costs[parents] + durations * self.problem.step_cost(self.simulator, controls)
        kept = self._add(parents, controls, durations, states, costs)
        return len(self.costs) - len(kept) + np.arange(len(kept))

    def add_servos(
        self,
        parents: np.ndarray,
        aims: np.ndarray,
        sequences: Sequence[np.ndarray],
        states: np.ndarray,
    ) -> np.ndarray:
        """Add nodes at the ends of edges that servo, as `add` does; return their numbers.

        Args:
            parents: node from which each edge starts.
            aims: action of each edge; see `primitives`.
            sequences: controls of each edge, one per physics step.
            states: end of each edge.
        """
        spent = [float(self.problem.step_cost(self.simulator, sequence).sum()) for sequence in sequences]
        durations = np.array([len(sequence) for sequence in sequences], dtype=int)
        kept = self._add(parents, aims, durations, states, self.costs[parents] + np.array(spent))
        nodes = len(self.costs) - len(kept) + np.arange(len(kept))
        self.servos[nodes] = True
        self.sequences.update(zip(nodes.tolist(), (sequences[i] for i in kept), strict=True))
        return nodes

    def _add(
        self,
        parents: np.ndarray,
        controls: np.ndarray,
        durations: np.ndarray,
        states: np.ndarray,
        costs: np.ndarray,
    ) -> np.ndarray:
        """Add the nodes that are the cheapest in their witness cell; return which were added."""
        features = self.features_of(states)
        keys = self._keys(features)
        if len(parents):
            moved = np.abs(features - self.features[parents]).max(axis=1)
            self.cells_per_edge = float(np.median(moved)) / self.cell_size
        winners: dict[int, int] = {}
        for i in np.argsort(costs, kind="stable").tolist():
            cell = self._cells.get(keys[i])
            if keys[i] not in winners and (cell is None or costs[i] < self.costs[self._winner[cell]]):
                winners[keys[i]] = i
        kept = np.array(sorted(winners.values()), dtype=int)
        first = len(self.costs)
        self.states = np.concatenate([self.states, states[kept]])
        self.features = np.concatenate([self.features, features[kept]])
        self.parents = np.concatenate([self.parents, parents[kept]])
        self.controls = np.concatenate([self.controls, controls[kept]])
        self.durations = np.concatenate([self.durations, durations[kept]])
        self.costs = np.concatenate([self.costs, costs[kept]])
        self.servos = np.concatenate([self.servos, np.zeros(len(kept), dtype=bool)])
        self._enter(first, [keys[i] for i in kept])
        return kept

    def shrink(self, factor: float) -> None:
        """Shrink the witness cells and choose the representative of each again, among all nodes."""
        self.cell_size *= factor
        self._sort_into_cells()

    def path(self, node: int) -> Float[np.ndarray, "step control"]:
        """The controls from the root to a node, one per physics step."""
        chain = []
        while node > 0:
            chain.append(node)
            node = int(self.parents[node])
        chain.reverse()
        if not self.sequences:
            return np.repeat(self.controls[chain], self.durations[chain], axis=0)
        edges = [
            self.sequences.get(i, self.controls[i][None].repeat(self.durations[i], axis=0)) for i in chain
        ]
        return np.concatenate([self.controls[:0], *edges])

    def _sort_into_cells(self) -> None:
        self._cells: dict[int, int] = {}
        self._winner = np.empty(0, dtype=int)  # cell to its representative
        self._cell = np.empty(0, dtype=int)  # node to its cell
        self._enter(0, self._keys(self.features))

    def _enter(self, first: int, keys: list[int]) -> None:
        """Put the nodes from `first` on into their cells. The cheapest node in a cell represents it."""
        new_cells = []
        for key in keys:
            if key not in self._cells:
                self._cells[key] = len(self._cells)
                new_cells.append(-1)
        cells = np.array([self._cells[key] for key in keys], dtype=int)
        self._cell = np.concatenate([self._cell, cells])
        self._winner = np.concatenate([self._winner, np.array(new_cells, dtype=int)])
        for node, cell in enumerate(cells.tolist(), start=first):
            if self._winner[cell] < 0 or self.costs[node] < self.costs[self._winner[cell]]:
                self._winner[cell] = node

    def _keys(self, features: np.ndarray) -> list[int]:
        """A 64-bit hash of each witness cell. The probability that two cells share a hash is 2^-64."""
        rows = np.floor(features / self.cell_size).astype(np.int64)
        with np.errstate(over="ignore"):
            mixed = rows * self._hash  # integer overflow is intended
            mixed ^= mixed >> 29
            return (mixed * self._hash[::-1]).sum(axis=1).tolist()

    def _neighbours(self, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nearest nodes by feature distance, nearest first.

        The index of the older nodes is rebuilt when the tree has grown by half; a small index of the other
        nodes is built each round. So late rounds cost about as much as early ones.
        """
        size = len(self.features)
        if self._old is None or size > 1.5 * self._indexed:
            self._old, self._indexed = cKDTree(self.features), size
        distances, nodes = self._ask(self._old, targets, 0)
        if size > self._indexed:
            late = self._ask(cKDTree(self.features[self._indexed :]), targets, self._indexed)
            distances, nodes = _nearest(distances, nodes, *late)
        return distances, nodes

    def _ask(self, index: cKDTree, targets: np.ndarray, offset: int) -> tuple[np.ndarray, np.ndarray]:
        k = min(NEIGHBOURS, index.n)
        threads = self.simulator.threads or -1  # 0 means all CPUs, which SciPy calls -1
        distances, nodes = index.query(targets, k=k, eps=NEIGHBOUR_SLACK, workers=threads)
        shape = (len(targets), k)
        return distances.reshape(shape), nodes.reshape(shape) + offset


def _nearest(
    distances: np.ndarray, nodes: np.ndarray, more_distances: np.ndarray, more_nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Merge two lists of neighbours into the nearest ones, in order."""
    distances = np.concatenate([distances, more_distances], axis=1)
    nodes = np.concatenate([nodes, more_nodes], axis=1)
    order = np.argsort(distances, axis=1, kind="stable")[:, :NEIGHBOURS]
    return np.take_along_axis(distances, order, axis=1), np.take_along_axis(nodes, order, axis=1)
