"""SST*: stable sparse trees (Li, Littlefield and Bekris 2016), with many extensions per round.

One round:

1. Draw random states. For each, choose the cheapest node near it, or the nearest node.
2. Extend all chosen nodes at once with random controls.
3. Keep the new nodes that are the cheapest in their witness cell.
4. Every `tail_every` rounds, let the regulator try to reach the goal from the most promising new nodes; if
   nothing helps for long, computed torque tries too.
5. Every `shrink_every` rounds, shrink the selection radius and the witness cells, and sort all nodes into the
   smaller cells (the star in SST*).

As in the original, best-near selection and one representative per witness region keep the tree sparse and its
paths short. Two things differ: witness regions are the cells of a grid over the features, found by hashing,
while the original searches for the nearest witness; and many extensions share one round.
"""

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from planspace.demos.search_tree import SearchTree
from planspace.physics.simulator import Simulator
from planspace.plan.computed_torque import ComputedTorque
from planspace.plan.diagnosis import explain_failure
from planspace.plan.durations import num_steps
from planspace.plan.metric import checked_distances
from planspace.plan.primitives import Edges, Servo
from planspace.plan.query import Query
from planspace.plan.sst import SST
from planspace.plan.tree import Tree

CHECK_S = 0.01
"""Time between two checks of the states along an edge [s]; at least one physics step."""
LEAST_CELLS = 0.25
"""Edges are lengthened if they cross less than this part of a witness cell, in the median."""
BY_METRIC = 0.25
"""Fraction of greedy extensions if a metric is given and the setting `greedy` is 0."""
PATIENCE = 24
"""Rounds without a solution after which a robot with a motor on every joint is also driven to the goal by
computed torque."""
MAX_STRETCH = 32.0
"""Largest factor by which the duration of edges is multiplied."""
GREED = 4.0
"""Of n nodes ordered by distance to the goal, greedy selection draws number n u^GREED, with u uniform in
[0, 1]: a third of the draws are among the nearest 1 %, whatever n is."""


@dataclass(frozen=True)
class SearchResult:
    """The best path of a search."""

    controls: Float[np.ndarray, "step control"]
    """The controls of the tree's path and of the regulator after it, one per physics step."""
    arrived: bool
    """Whether the path ends in the goal region. If not, it is the most promising one."""
    cost: float
    """Cost of the path [s]."""
    nearest: float
    """Smallest distance to the goal of any node, in the goal's measure."""
    nodes: int
    """Number of nodes in the tree."""
    simulated_steps: int
    """Physics steps taken to extend the tree and by the regulator."""
    tree: SearchTree
    """The nodes from which the search would have gone on, and their ancestors."""
    explanation: str = ""
    """What the search saw, if it found no path."""


class SSTSearch:
    """One search from a start to a goal."""

    def __init__(self, config: SST, query: Query, rng: np.random.Generator):
        """Prepare a search; `solve` runs it.

        Args:
            config: the planner's settings.
            query: start, goal, and simulations, which are overwritten.
            rng: all randomness of the search.
        """
        self.config, self.start, self.rng = config, query.start, rng
        self.problem, self.regulator, self.goal = query.problem, query.regulator, query.goal
        self.simulator = _large_enough(query.simulator, config)
        self.servo = Servo(self.simulator)
        self.torque = ComputedTorque(self.simulator)
        self.space = self.simulator.space
        self.metric = query.metric
        self.to_goal = np.empty(0)  # distance of each node to the goal by the metric
        self.stride = num_steps(CHECK_S, self.simulator.model)
        self.stretch = 1.0

    def solve(self) -> SearchResult:
        """Search until a solution has been found and `min_rounds` have passed.

        Returns:
            The cheapest solution found. If there is no solution, the path to the node from which the goal
            looked cheapest to reach.
        """
        c, began = self.config, time.monotonic()
        tree = Tree(self.start, self.problem, self.simulator, c.witness_size)
        radius, steps = c.selection_radius, 0
        finish = _Finish(self, tree)
        finish.consider(np.array([0]))
        new: list[np.ndarray] = []
        for round_index in range(c.max_rounds if not c.seconds else 1 << 30):
            if c.seconds:
                if time.monotonic() - began > c.seconds:
                    break
            elif finish.arrived and round_index >= c.min_rounds:
                break
            if round_index and round_index % c.shrink_every == 0:
                radius *= c.shrink
                tree.shrink(c.shrink)
            if tree.cells_per_edge < LEAST_CELLS and self.stretch < MAX_STRETCH:
                self.stretch *= 2.0  # edges are too short: a heavy robot, or a velocity bound far too high
            parents = self._select(tree, radius)
            edges = self._draw_edges(tree, parents)
            steps += int(edges.durations.sum())
            new += self._extend(tree, parents, edges)
            if (round_index + 1) % c.tail_every == 0:
                finish.consider(np.concatenate(new))
                new = []
                if self.torque.fits and round_index >= PATIENCE and not finish.arrived:
                    finish.drive()
        finish.consider(np.concatenate([np.empty(0, dtype=int), *new]))
        nearest = float(self.goal.distance(tree.states).min())
        steps += finish.simulated_steps
        explanation = "" if finish.arrived else self._explain(tree, radius)
        return SearchResult(
            controls=finish.controls(),
            arrived=finish.arrived,
            cost=finish.cost,
            nearest=nearest,
            nodes=len(tree.costs),
            simulated_steps=steps,
            tree=tree.search_tree(),
            explanation=explanation,
        )

    def _select(self, tree: Tree, radius: float) -> np.ndarray:
        """The nodes to extend: those near random states, and a fraction of nodes near the goal."""
        parents = tree.select(tree.features_of(self._targets()), radius)
        greedy = self.config.greedy or (BY_METRIC if self.metric else 0.0)
        if num := round(greedy * len(parents)):
            nodes = tree.representatives()
            order = nodes[np.argsort(self._distances(tree, nodes), kind="stable")]
            ranks = len(order) * self.rng.random(num) ** GREED
            parents[-num:] = order[ranks.astype(int)]
        return parents

    def _distances(self, tree: Tree, nodes: np.ndarray) -> np.ndarray:
        """Distance of some nodes to the goal: by the metric, asked once each, or in the goal's measure."""
        if self.metric is None:
            return self.goal.distance(tree.states[nodes])
        new = tree.states[len(self.to_goal) :]
        found = checked_distances(self.metric, new, self.goal.nearest(new))
        self.to_goal = np.concatenate([self.to_goal, found])
        return self.to_goal[nodes]

    def _extend(self, tree: Tree, parents: np.ndarray, edges: Edges) -> list[np.ndarray]:
        """Simulate the edges and add their ends to the tree; return the numbers of the new nodes."""
        plain, new = np.flatnonzero(~edges.servos), []
        if len(plain):
            parent, controls, durations = parents[plain], edges.actions[plain], edges.durations[plain]
            ends, valid = self.simulator.propagate(tree.states[parent], controls, durations, self.stride)
            new.append(tree.add(parent[valid], controls[valid], durations[valid], ends[valid]))
        if len(driven := np.flatnonzero(edges.servos)):
            parent, aims, durations = parents[driven], edges.actions[driven], edges.durations[driven]
            ends, valid, applied = self.servo.propagate(tree.states[parent], aims, durations, self.stride)
            kept = [applied[i] for i in np.flatnonzero(valid)]
            new.append(tree.add_servos(parent[valid], aims[valid], kept, ends[valid]))
        return new

    def _explain(self, tree: Tree, radius: float) -> str:
        parents = self._select(tree, radius)
        controls, durations = self._draw_controls()
        return explain_failure(self.simulator, tree, parents, controls, durations)

    def _targets(self) -> Float[np.ndarray, "extension state"]:
        c = self.config
        targets = self.space.sample(self.rng, c.extensions, self.problem.speed(self.space))
        goals = round(c.goal_bias * c.extensions)
        within = self.rng.uniform(-1.0, 1.0, (goals, self.space.tangent_size)) * self.goal.half
        targets[:goals] = self.space.integrate(self.goal.center, within)
        return targets

    def _draw_edges(self, tree: Tree, parents: np.ndarray) -> Edges:
        """Draw what each edge does; see `primitives`."""
        c = self.config
        actions, durations = self._draw_controls()
        servos = np.zeros(len(actions), dtype=bool)
        if c.servo and len(self.servo.motors):
            servos = self.rng.random(len(actions)) < c.servo
            actions[servos] = self.servo.draw(self.rng, actions[servos])
        if c.hold_last:
            held = (self.rng.random(len(actions)) < c.hold_last) & (parents > 0)
            actions[held], servos[held] = tree.controls[parents[held]], tree.servos[parents[held]]
        return Edges(actions, servos, durations)

    def _draw_controls(self) -> tuple[np.ndarray, np.ndarray]:
        c, low, high = self.config, self.simulator.control_low, self.simulator.control_high
        shape = (c.extensions, len(low))
        controls = self.rng.uniform(low, high, shape)
        extreme = self.rng.random((c.extensions, 1)) < c.bang_bang
        controls = np.where(extreme, np.where(self.rng.random(shape) < 0.5, low, high), controls)
        unit = self.stride * self.simulator.model.opt.timestep
        least, most = (max(1, round(self.stretch * s / unit)) for s in (c.min_edge_s, c.max_edge_s))
        return controls, self.stride * self.rng.integers(least, most + 1, c.extensions)


def _large_enough(simulator: Simulator, config: SST) -> Simulator:
    """The query's simulations, or new ones if a round needs more."""
    num = max(config.extensions, config.tail_candidates)
    if simulator.num >= num:
        return simulator
    return Simulator(
        simulator.model, simulator.space, num, threads=simulator.threads, validity=simulator.validity
    )


class _Finish:
    """The best path to the goal so far: a node, and the regulator's controls from there."""

    def __init__(self, query: SSTSearch, tree: Tree):
        self.query, self.tree = query, tree
        self.arrived, self.cost, self.simulated_steps = False, np.inf, 0
        self._promise = np.inf  # the regulator's cost estimate at the node to fall back on
        self._node, self._tail = 0, np.empty((0, len(query.simulator.control_low)))

    def consider(self, new: np.ndarray) -> None:
        """Run the regulator from the most promising of the new nodes.

        If the goal need not be held, a node in the goal region is a solution itself.
        """
        query, tree = self.query, self.tree
        if not query.problem.hold:
            self._consider_nodes(new[query.goal.reached(tree.states[new])])
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
        self._keep_best(new[order], tails, steps, arrived)

    def drive(self) -> None:
        """Drive from the start and from the last new nodes to the goal by computed torque."""
        query, tree = self.query, self.tree
        last = np.arange(max(1, len(tree.costs) - query.config.tail_candidates + 1), len(tree.costs))
        nodes = np.concatenate([[0], last])
        tails, steps, arrived = query.torque.finish(query.goal, tree.states[nodes])
        self.simulated_steps += int(steps.sum())
        self._keep_best(nodes, tails, steps, arrived)

    def _keep_best(
        self, nodes: np.ndarray, tails: np.ndarray, steps: np.ndarray, arrived: np.ndarray
    ) -> None:
        """Keep the cheapest path that arrived, if it is cheaper than the best so far."""
        for i in np.flatnonzero(arrived):
            tail = tails[i, : steps[i]]
            cost = self.tree.costs[nodes[i]] + self.query.problem.step_cost(self.query.simulator, tail).sum()
            if cost < self.cost:
                self.arrived, self.cost = True, float(cost)
                self._node, self._tail = int(nodes[i]), tail

    def _consider_nodes(self, nodes: np.ndarray) -> None:
        if len(nodes) and self.tree.costs[nodes].min() < self.cost:
            self._node = int(nodes[self.tree.costs[nodes].argmin()])
            self.arrived, self.cost = True, float(self.tree.costs[self._node])
            self._tail = self._tail[:0]

    def controls(self) -> np.ndarray:
        """The controls along the path to the node and then of the regulator, one per physics step."""
        return np.concatenate([self.tree.path(self._node), self._tail])
