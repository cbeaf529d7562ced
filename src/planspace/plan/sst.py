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

from planspace.physics.simulator import Simulator
from planspace.plan.regulator import Regulator
from planspace.plan.tree import Tree
from planspace.tasks.problem import Goal, Problem


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
    min_edge_steps: int = 1
    """An edge holds its control for at least this many physics steps ..."""
    max_edge_steps: int = 10
    """... and at most this many."""
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
        if min(self.extensions, self.min_rounds, self.max_rounds, self.min_edge_steps) < 1:
            raise ValueError("extensions, rounds and edge steps must be at least 1")
        if self.min_edge_steps > self.max_edge_steps:
            raise ValueError(
                f"min_edge_steps must be at most {self.max_edge_steps}, got {self.min_edge_steps}"
            )
        if min(self.shrink_every, self.tail_every, self.tail_candidates) < 1 or self.seconds < 0:
            raise ValueError("shrink_every, tail_every and tail_candidates must be at least 1, seconds 0")
        if not 0 < self.shrink <= 1:
            raise ValueError(f"shrink must lie in (0, 1], got {self.shrink}")
        if not (0 <= self.goal_bias <= 1 and 0 <= self.bang_bang <= 1):
            raise ValueError("goal_bias and bang_bang are shares: they must lie in [0, 1]")
        if not (self.witness_size > 0 and self.selection_radius >= 0):
            raise ValueError("witness_size must be positive, selection_radius not negative")


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
        tree = Tree(start, self.problem, self.simulator, c.witness_size)
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
        return controls, self.rng.integers(c.min_edge_steps, c.max_edge_steps + 1, c.extensions)


class _Finish:
    """The best way to the goal so far: a node, and what the regulator does from there."""

    def __init__(self, query: SST, tree: Tree):
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
            cost = tree.costs[new[order[i]]] + query.problem.step_cost(query.simulator, tail).sum()
            if cost < self.cost:
                self.arrived, self.cost = True, float(cost)
                self._node, self._tail = int(new[order[i]]), tail

    def controls(self) -> np.ndarray:
        """The path to the node, one control a step, and the regulator's end."""
        return np.concatenate([self.tree.path(self._node), self._tail])
