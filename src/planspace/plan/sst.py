"""SST, batched: stable sparse trees (Li, Littlefield and Bekris 2016) with many extensions a round.

Per round: draw random states; for each, choose the cheapest node near it (or the nearest); extend all the
chosen nodes at once by random controls; keep of the new nodes those that are the cheapest in their witness
cell. From the new nodes most promising for the goal, the regulator of `polish` tries to finish.

Kept as in the original: best-near selection and one representative a witness region, which keep the tree
sparse and its paths short. Different: witness regions are the cells of a grid over the features, found
by hashing, where the original searches for the nearest witness; many extensions share one round.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from planspace.physics.simulate import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.polish import GoalRegulator
from planspace.plan.problem import Problem

NEIGHBOURS = 8
"""Best-near selection looks at this many neighbours."""


@dataclass(frozen=True)
class SSTConfig:
    """Settings of the planner. Budgets count rounds, so that a seed gives the same plan on any machine."""

    extensions: int = 512
    """Extensions a round."""
    min_rounds: int = 60
    """Rounds before a solution is accepted: the time to improve on the first."""
    max_rounds: int = 240
    """Rounds before giving up."""
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
    tail_candidates: int = 8
    """New nodes a round from which the regulator tries to reach the goal."""


@dataclass(frozen=True)
class Solution:
    """A path through the tree and how the regulator ends it."""

    controls: Float[np.ndarray, "edge control"]
    """The control of each edge."""
    durations: np.ndarray
    """Physics steps of each edge."""
    tail_steps: int
    """Physics steps the regulator takes from the end of the last edge into the goal region."""

    @property
    def cost(self) -> int:
        """Physics steps from start to goal."""
        return int(self.durations.sum()) + self.tail_steps


class SST:
    """One planning query: from a start to a goal."""

    def __init__(
        self,
        problem: Problem,
        simulator: Simulator,
        regulator: GoalRegulator,
        config: SSTConfig,
        rng: np.random.Generator,
    ):
        """Prepares a query; `solve` runs it.

        Args:
            problem: what to plan.
            simulator: at least `config.extensions` simulations; overwritten.
            regulator: takes over near the goal.
            config: settings.
            rng: all randomness of the query.
        """
        self.problem, self.simulator, self.regulator = problem, simulator, regulator
        self.config, self.rng, self.space = config, rng, simulator.space
        self.weights = np.array(problem.feature_weights)

    def solve(self, start: Float[np.ndarray, " state"]) -> Solution | None:
        """Searches from a start until a solution has been found and `min_rounds` have passed.

        Returns:
            The shortest solution found, or None.
        """
        tree = _Tree(start, self.space, self.weights, self.config.witness_size)
        best = self._try_tail(tree, np.array([0]), None)
        for round_index in range(self.config.max_rounds):
            if best is not None and round_index >= self.config.min_rounds:
                break
            parents = tree.select(self._targets(), self.config.selection_radius)
            controls, durations = self._draw_edges()
            ends, valid = self.simulator.propagate(tree.states[parents], controls, durations)
            new = tree.add(parents[valid], controls[valid], durations[valid], ends[valid])
            best = self._try_tail(tree, new, best)
        return best

    def _targets(self) -> Float[np.ndarray, "extension feature"]:
        c, n = self.config, len(self.space.joints)
        bounded = np.isfinite(self.space.low)
        low = np.where(bounded, self.space.low, -np.pi)
        high = np.where(bounded, self.space.high, np.pi)
        speed = np.array(self.problem.sample_velocity)
        targets = self.rng.uniform(
            np.concatenate([low, -speed]), np.concatenate([high, speed]), (c.extensions, 2 * n)
        )
        targets[: round(c.goal_bias * c.extensions)] = self.regulator.goal
        return self.space.features(targets, self.weights)

    def _draw_edges(self) -> tuple[np.ndarray, np.ndarray]:
        c, low, high = self.config, self.simulator.control_low, self.simulator.control_high
        shape = (c.extensions, len(low))
        controls = self.rng.uniform(low, high, shape)
        extreme = self.rng.random((c.extensions, 1)) < c.bang_bang
        controls = np.where(extreme, np.where(self.rng.random(shape) < 0.5, low, high), controls)
        return controls, self.rng.integers(1, c.max_edge_steps + 1, c.extensions)

    def _try_tail(self, tree: "_Tree", new: np.ndarray, best: Solution | None) -> Solution | None:
        if best is not None:
            new = new[tree.costs[new] < best.cost]
        if len(new) == 0:
            return best
        states = tree.states[new]
        order = np.argsort(self.regulator.cost_to_go(states), kind="stable")[: self.config.tail_candidates]
        steps, arrived = self.regulator.steps_to_goal(self.simulator, states[order], self.problem.tolerance)
        for index, tail in zip(new[order[arrived]], steps[arrived], strict=True):
            if best is None or tree.costs[index] + tail < best.cost:
                best = Solution(*tree.path(int(index)), tail_steps=int(tail))
        return best


class _Tree:
    """The nodes as growing arrays, and one representative for each witness cell."""

    def __init__(
        self, root: Float[np.ndarray, " state"], space: StateSpace, weights: np.ndarray, cell_size: float
    ):
        self.space, self.weights, self.cell_size = space, weights, cell_size
        self.states = root[None].copy()
        self.features = space.features(self.states, weights)
        self.parents = np.array([-1])
        self.controls: list[np.ndarray] = [np.empty(0)]
        self.durations = np.array([0])
        self.costs = np.array([0])
        self.cells = {self._cells(self.features)[0]: 0}
        self._indexed = 0
        self._old: cKDTree | None = None

    def select(self, targets: Float[np.ndarray, "batch feature"], radius: float) -> np.ndarray:
        """Best-near selection: the cheapest node within the radius of each target, else the nearest."""
        distances, nodes = self._neighbours(targets)
        nodes = self._representatives(nodes)
        costs = np.where(distances <= radius, self.costs[nodes], np.iinfo(np.int64).max)
        near = distances[:, 0] <= radius
        choice = np.where(near, costs.argmin(axis=1), 0)
        return nodes[np.arange(len(nodes)), choice]

    def add(
        self, parents: np.ndarray, controls: np.ndarray, durations: np.ndarray, states: np.ndarray
    ) -> np.ndarray:
        """Adds the nodes that are the cheapest in their witness cell; returns their numbers."""
        costs = self.costs[parents] + durations
        features = self.space.features(states, self.weights)
        cells = self._cells(features)
        winners: dict[bytes, int] = {}
        for i in np.argsort(costs, kind="stable"):
            cell = cells[i]
            if cell not in winners and (cell not in self.cells or costs[i] < self.costs[self.cells[cell]]):
                winners[cell] = int(i)
        kept = np.array(sorted(winners.values()), dtype=int)
        new = len(self.costs) + np.arange(len(kept))
        for number, i in zip(new, kept, strict=True):
            self.cells[cells[i]] = int(number)
        self.states = np.concatenate([self.states, states[kept]])
        self.features = np.concatenate([self.features, features[kept]])
        self.parents = np.concatenate([self.parents, parents[kept]])
        self.controls.extend(controls[kept])
        self.durations = np.concatenate([self.durations, durations[kept]])
        self.costs = np.concatenate([self.costs, costs[kept]])
        return new

    def path(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """Controls and durations of the edges from the root to a node."""
        chain = []
        while node > 0:
            chain.append(node)
            node = int(self.parents[node])
        chain.reverse()
        if not chain:
            return np.empty((0, 0)), np.empty(0, dtype=int)
        return np.stack([self.controls[i] for i in chain]), self.durations[chain]

    def _representatives(self, nodes: np.ndarray) -> np.ndarray:
        flat = self._cells(self.features[nodes.ravel()])
        return np.array([self.cells[cell] for cell in flat]).reshape(nodes.shape)

    def _cells(self, features: np.ndarray) -> list[bytes]:
        rows = np.floor(features / self.cell_size).astype(np.int32)
        return [row.tobytes() for row in rows]

    def _neighbours(self, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nearest nodes by feature distance, nearest first.

        An index over the older nodes is rebuilt whenever the tree has grown by a half, and a small one over
        the rest is built each round: a round costs about as much late as early.
        """
        size = len(self.features)
        if self._old is None or size > 1.5 * self._indexed:
            self._old, self._indexed = cKDTree(self.features), size
        distances, nodes = self._query(self._old, targets, 0)
        if size > self._indexed:
            late = self._query(cKDTree(self.features[self._indexed :]), targets, self._indexed)
            distances = np.concatenate([distances, late[0]], axis=1)
            nodes = np.concatenate([nodes, late[1]], axis=1)
            order = np.argsort(distances, axis=1, kind="stable")[:, :NEIGHBOURS]
            distances = np.take_along_axis(distances, order, axis=1)
            nodes = np.take_along_axis(nodes, order, axis=1)
        return distances, nodes

    @staticmethod
    def _query(index: cKDTree, targets: np.ndarray, offset: int) -> tuple[np.ndarray, np.ndarray]:
        k = min(NEIGHBOURS, index.n)
        distances, nodes = index.query(targets, k=k)
        shape = (len(targets), k)
        return distances.reshape(shape), nodes.reshape(shape) + offset
