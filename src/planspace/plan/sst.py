"""SST*, batched: stable sparse trees (Li, Littlefield and Bekris 2016) with many extensions a round.

Per round: draw random states; for each, choose the cheapest node near it (or the nearest); extend all the
chosen nodes at once by random controls; keep of the new nodes those that are the cheapest in their witness
cell. From the new nodes most promising for the goal, the regulator tries to finish. Every `shrink_every`
rounds both radii shrink and the tree, with all its nodes, is sorted into the smaller cells: the star.

Kept as in the original: best-near selection and one representative a witness region, which keep the tree
sparse and its paths short. Different: witness regions are the cells of a grid over the features, found
by hashing, where the original searches for the nearest witness; many extensions share one round.
"""

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from planspace.physics.simulate import Simulator
from planspace.plan.problem import Goal, Problem
from planspace.plan.regulator import Regulator

NEIGHBOURS = 8
"""Best-near selection looks at this many neighbours."""
NEIGHBOUR_SLACK = 2.0
"""A neighbour found is at most 1 + this times as far as the true one. With 2, the nearest is 1 % too far on
average, and in 14 dimensions the search takes 4 ms in place of 100 (512 targets among 23,000 nodes)."""
IDLE_COST = 0.1
"""Effort counts a second of rest like a tenth of a second at full control, so that plans end."""


@dataclass(frozen=True)
class SSTConfig:
    """Settings of the planner. Budgets count rounds, so that a seed gives the same plan on any machine."""

    extensions: int = 512
    """Extensions a round."""
    min_rounds: int = 4
    """Rounds before a solution is accepted: the time to improve on the first."""
    max_rounds: int = 240
    """Rounds before giving up."""
    seconds: float = 0.0
    """If positive, search for so long instead, improving all the while; no longer reproducible."""
    max_edge_steps: int = 10
    """An edge holds its control for 1 to this many physics steps."""
    goal_bias: float = 0.1
    """Share of extensions that aim at the goal."""
    bang_bang: float = 0.3
    """Share of controls drawn at the ends of their range instead of inside it."""
    selection_radius: float = 0.3
    """Best-near selection: within this distance of features the cheapest node is chosen."""
    witness_size: float = 0.08
    """Side of a witness cell, in features."""
    shrink: float = 0.8
    """The two radii are multiplied by this ..."""
    shrink_every: int = 60
    """... every so many rounds."""
    tail_every: int = 4
    """Every so many rounds the regulator tries to reach the goal ..."""
    tail_candidates: int = 32
    """... from so many of the new nodes, the most promising."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if min(self.extensions, self.min_rounds, self.max_rounds, self.max_edge_steps) < 1:
            raise ValueError("extensions, rounds and edge steps must be at least 1")
        if not (0 < self.shrink <= 1 and self.shrink_every >= 1):
            raise ValueError(f"shrink must lie in (0, 1], got {self.shrink}")


@dataclass(frozen=True)
class Search:
    """What came of a search."""

    controls: Float[np.ndarray, "step control"]
    """The best path found and the regulator's end of it, one control a physics step."""
    arrived: bool
    """Whether it ends in the goal region; if not, it is the most promising one."""
    cost: float
    """Its cost [s]."""
    nearest: float
    """The smallest distance to the goal of any node, in the goal's measure."""
    nodes: int
    """Nodes in the tree."""
    simulated_steps: int
    """Physics steps taken, to extend the tree and in the regulator's tries."""
    note: str = ""
    """What went wrong, if something did."""


def step_cost(problem: Problem, simulator: Simulator, controls: np.ndarray) -> np.ndarray:
    """What one physics step under each control costs [s]: its time, or its share of the full control."""
    dt = simulator.model.opt.timestep
    if problem.cost == "duration":
        return np.full(controls.shape[:-1], dt)
    largest = np.maximum(np.abs(simulator.control_low), np.abs(simulator.control_high))
    return dt * (IDLE_COST + (np.abs(controls) / largest).mean(axis=-1))


class SST:
    """One planning query: from a start to a goal."""

    def __init__(
        self,
        problem: Problem,
        simulator: Simulator,
        regulator: Regulator,
        config: SSTConfig,
        rng: np.random.Generator,
    ):
        """Prepares a query; `solve` runs it.

        Args:
            problem: what to plan.
            simulator: at least `config.extensions` simulations; overwritten.
            regulator: knows the goal, and takes over near it.
            config: settings.
            rng: all randomness of the query.
        """
        self.problem, self.simulator, self.regulator = problem, simulator, regulator
        self.config, self.rng, self.space = config, rng, simulator.space
        self.goal: Goal = regulator.goal
        self.weights = problem.weights(self.space)

    def solve(self, start: Float[np.ndarray, " state"]) -> Search:
        """Searches from a start until a solution has been found and `min_rounds` have passed.

        Returns:
            The cheapest solution found; without one, the path to the node from which the goal looked
            cheapest to reach.
        """
        c, began = self.config, time.monotonic()
        tree = _Tree(start, self, c.witness_size)
        radius, steps = c.selection_radius, 0
        finish = _Finish(self, tree)
        new = [np.array([0])]
        finish.consider(new.pop())
        for round_index in range(c.max_rounds if not c.seconds else 1 << 30):
            if c.seconds:
                if time.monotonic() - began > c.seconds:
                    break
            elif finish.arrived and round_index >= c.min_rounds:
                break
            if round_index and round_index % c.shrink_every == 0:
                radius *= c.shrink
                tree.shrink(c.shrink)
            parents = tree.select(self._targets(), radius)
            controls, durations = self._draw_edges()
            ends, valid = self.simulator.propagate(tree.states[parents], controls, durations)
            steps += int(durations.sum())
            new.append(tree.add(parents[valid], controls[valid], durations[valid], ends[valid]))
            if (round_index + 1) % c.tail_every == 0:
                finish.consider(np.concatenate(new))
                new = []
        finish.consider(np.concatenate([np.empty(0, dtype=int), *new]))
        nearest = float(self.goal.distance(tree.states).min())
        steps += finish.simulated_steps
        return Search(finish.controls(), finish.arrived, finish.cost, nearest, len(tree.costs), steps)

    def _targets(self) -> Float[np.ndarray, "extension feature"]:
        c = self.config
        targets = self.space.sample(self.rng, c.extensions, self.problem.speed(self.space))
        goals = round(c.goal_bias * c.extensions)
        within = self.rng.uniform(-1.0, 1.0, (goals, self.space.tangent_size)) * self.goal.half
        targets[:goals] = self.space.integrate(self.goal.center, within)
        return self.space.features(targets, self.weights)

    def _draw_edges(self) -> tuple[np.ndarray, np.ndarray]:
        c, low, high = self.config, self.simulator.control_low, self.simulator.control_high
        shape = (c.extensions, len(low))
        controls = self.rng.uniform(low, high, shape)
        extreme = self.rng.random((c.extensions, 1)) < c.bang_bang
        controls = np.where(extreme, np.where(self.rng.random(shape) < 0.5, low, high), controls)
        return controls, self.rng.integers(1, c.max_edge_steps + 1, c.extensions)


class _Finish:
    """The best way to the goal so far: a node, and what the regulator does from there."""

    def __init__(self, query: SST, tree: "_Tree"):
        self.query, self.tree = query, tree
        self.arrived, self.cost, self.simulated_steps = False, np.inf, 0
        self._promise = np.inf  # of the node to fall back on: the regulator's own estimate
        self._node, self._tail = 0, np.empty((0, len(query.simulator.control_low)))

    def consider(self, new: np.ndarray) -> None:
        """Runs the regulator from the most promising of the new nodes."""
        query, tree = self.query, self.tree
        if self.arrived:
            new = new[tree.costs[new] < self.cost]
        if len(new) == 0:
            return
        promise = query.regulator.cost_to_go(tree.states[new])
        order = np.argsort(promise, kind="stable")[: query.config.tail_candidates]
        tails, steps, arrived = query.regulator.finish(query.simulator, tree.states[new[order]])
        self.simulated_steps += int(steps.sum())
        if not self.arrived and promise[order[0]] < self._promise:
            self._promise = promise[order[0]]
            self._node, self._tail = int(new[order[0]]), tails[0, : steps[0]]
        for i in np.flatnonzero(arrived):
            tail = tails[i, : steps[i]]
            cost = tree.costs[new[order[i]]] + step_cost(query.problem, query.simulator, tail).sum()
            if cost < self.cost:
                self.arrived, self.cost = True, float(cost)
                self._node, self._tail = int(new[order[i]]), tail

    def controls(self) -> np.ndarray:
        """The path to the node, one control a step, and the regulator's end."""
        return np.concatenate([self.tree.path(self._node), self._tail])


class _Tree:
    """The nodes as growing arrays, and one representative for each witness cell."""

    def __init__(self, root: Float[np.ndarray, " state"], query: SST, cell_size: float):
        self.query, self.cell_size = query, cell_size
        self.states = root[None].copy()
        self.features = query.space.features(self.states, query.weights)
        self.parents, self.durations, self.costs = np.array([-1]), np.array([0]), np.array([0.0])
        self.controls = np.zeros((1, len(query.simulator.control_low)))
        self._hash = np.random.default_rng(0).integers(1, 1 << 62, self.features.shape[1]) * 2 + 1
        self._sort_into_cells()
        self._indexed = 0
        self._old: cKDTree | None = None

    def select(self, targets: Float[np.ndarray, "batch feature"], radius: float) -> np.ndarray:
        """Best-near selection: the cheapest node within the radius of each target, else the nearest."""
        distances, nodes = self._neighbours(targets)
        for image in self.query.space.mirrored(targets):
            distances, nodes = _nearest(distances, nodes, *self._neighbours(image))
        nodes = self._winner[self._cell[nodes]]
        costs = np.where(distances <= radius, self.costs[nodes], np.inf)
        near = distances[:, 0] <= radius
        choice = np.where(near, costs.argmin(axis=1), 0)
        return nodes[np.arange(len(nodes)), choice]

    def add(
        self, parents: np.ndarray, controls: np.ndarray, durations: np.ndarray, states: np.ndarray
    ) -> np.ndarray:
        """Adds the nodes that are the cheapest in their witness cell; returns their numbers."""
        query = self.query
        costs = self.costs[parents] + durations * step_cost(query.problem, query.simulator, controls)
        features = query.space.features(states, query.weights)
        keys = self._keys(features)
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
        self._enter(first, [keys[i] for i in kept])
        return first + np.arange(len(kept))

    def shrink(self, factor: float) -> None:
        """Makes the witness cells smaller and chooses a representative for each anew, among all nodes."""
        self.cell_size *= factor
        self._sort_into_cells()

    def path(self, node: int) -> Float[np.ndarray, "step control"]:
        """The controls from the root to a node, one a physics step."""
        chain = []
        while node > 0:
            chain.append(node)
            node = int(self.parents[node])
        chain.reverse()
        return np.repeat(self.controls[chain], self.durations[chain], axis=0)

    def _sort_into_cells(self) -> None:
        self._cells: dict[int, int] = {}
        self._winner = np.empty(0, dtype=int)  # cell to its representative
        self._cell = np.empty(0, dtype=int)  # node to its cell
        self._enter(0, self._keys(self.features))

    def _enter(self, first: int, keys: list[int]) -> None:
        """Puts the nodes from `first` on into their cells; in each the cheapest represents it."""
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
        """A 64-bit hash of each witness cell; two cells share one with a chance of 2^-64."""
        rows = np.floor(features / self.cell_size).astype(np.int64)
        with np.errstate(over="ignore"):
            mixed = rows * self._hash  # wraps round, as a hash may
            mixed ^= mixed >> 29
            return (mixed * self._hash[::-1]).sum(axis=1).tolist()

    def _neighbours(self, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nearest nodes by feature distance, nearest first.

        An index over the older nodes is rebuilt whenever the tree has grown by a half, and a small one over
        the rest is built each round: a round costs about as much late as early.
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
        threads = self.query.simulator.threads or -1  # as many as the physics
        distances, nodes = index.query(targets, k=k, eps=NEIGHBOUR_SLACK, workers=threads)
        shape = (len(targets), k)
        return distances.reshape(shape), nodes.reshape(shape) + offset


def _nearest(
    distances: np.ndarray, nodes: np.ndarray, more_distances: np.ndarray, more_nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest of two lists of neighbours, in order."""
    distances = np.concatenate([distances, more_distances], axis=1)
    nodes = np.concatenate([nodes, more_nodes], axis=1)
    order = np.argsort(distances, axis=1, kind="stable")[:, :NEIGHBOURS]
    return np.take_along_axis(distances, order, axis=1), np.take_along_axis(nodes, order, axis=1)
