"""One demonstration: draw a start and a goal, search, polish, and prove the plan in plain MuJoCo."""

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.demos.episode import Episode
from planspace.demos.search_tree import SearchTree
from planspace.errors import UsageError
from planspace.physics.angles import unwrap_to_end
from planspace.physics.replay import advance
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.clearance import Clearance
from planspace.plan.config import PlanConfig
from planspace.plan.durations import num_steps
from planspace.plan.linearise import at_rest
from planspace.plan.motors import limit_accelerations
from planspace.plan.planner import PAGE, Failure, Plan, search
from planspace.plan.polish import Polish
from planspace.plan.proof import describe_unrest, replay_plan
from planspace.plan.query import Query
from planspace.plan.regulator import Regulator
from planspace.plan.shortcut import Shortcut, has_contacts
from planspace.plan.trajectory import Trajectory
from planspace.seams import name_of
from planspace.tasks.problem import Goal, Problem

MAX_ATTEMPTS = 3
"""Attempts per plan, each from another start."""
MOST_POLISHED = 2
"""Of several paths from one start, so many are polished, the cheapest ones."""
MAX_REDRAWS = 1000
"""Draws of a start that does not lie in the goal region."""
NUM_SIMULATIONS = 512
"""Simulations that a planner finds in its query."""
LANDINGS = (1.0, 0.5, 0.2)
"""A polished plan whose goal cannot be held is polished again, towards these fractions of the tolerance."""
SAME_STATES = 1e-9
"""Largest difference between two simulations of a plan that differ only in turns of an angle [any unit]."""
TREE_STREAM = 1
"""Number of the random stream that chooses the nodes of a tree, apart from those that plan."""
DEEPER_S = 0.2
"""Time added to a plan before it is polished again [s]."""


class Pipeline:
    """Plans demonstrations of one problem, one after another, in one process."""

    def __init__(self, problem: Problem, config: PlanConfig, *, threads: int = 1):
        """Compile the problem.

        Args:
            problem: what to plan.
            config: planner, polish and regulator.
            threads: physics threads.
        """
        self.problem, self.config = problem, config
        self.model, self.space = problem.compile()
        limit_accelerations(self.model, self.space)
        self.simulator = Simulator(
            self.model, self.space, NUM_SIMULATIONS, threads=threads, validity=problem.validity
        )
        self.weights = problem.weights(self.space)
        watched = problem.forbidden_contacts != "none"
        self.clearance = Clearance(problem, self.space, threads=threads) if watched else None

    def plan(self, seed: int, index: int) -> Episode | Failure:
        """Plan one demonstration; after a failure try again from another start."""
        nearest, reason = np.inf, ""
        for attempt in range(MAX_ATTEMPTS):
            rng = np.random.default_rng(np.random.SeedSequence([seed, index, attempt]))
            start, goal = self._draw(rng)
            found = self.connect(start, goal, rng)
            if isinstance(found, Trajectory):
                found = self._stored(found, goal)
            if isinstance(found, Trajectory):
                episode = self._episode(found, goal, index, attempt)
                return self._with_tree(episode, found.tree, seed) if self.config.keep_trees else episode
            nearest, reason = min(nearest, found.nearest), found.reason
        return Failure(reason, nearest)

    def describe_unrest(self) -> str:
        """Say how the robot leaves a goal that is to be held; empty if it does not, or goals are drawn."""
        if not self.problem.hold or self.problem.goal_random or self.problem.kinematic:
            return ""
        goal = at_rest(self.simulator, self.problem.draw_goal(self.space, np.random.default_rng(0)))
        return describe_unrest(self.query(goal.center, goal))

    def connect(
        self, start: Float[np.ndarray, " state"], goal: Goal, rng: np.random.Generator
    ) -> Trajectory | Failure:
        """The cheapest proven plan of several searches from one start.

        Raises:
            UsageError: the planner returned something that does not fit the protocol `Planner`.
        """
        if goal.reached(start):
            return Failure("the start lies in the goal region", 0.0)
        query = self.query(start, goal)
        found = [search(self.config.planner, query, rng) for _ in range(self.config.num_searches)]
        proven: list[tuple[float, int, Trajectory]] = []
        nearest, reason = np.inf, ""
        order = range(len(found))
        if len(found) > MOST_POLISHED:
            order = sorted(order, key=lambda i: self._path_cost(found[i]))
        for number in order:
            plan = self._prove(query, found[number], rng)
            if isinstance(plan, Failure):
                nearest, reason = min(nearest, plan.nearest), plan.reason
            else:
                proven.append((self._cost(plan), number, plan._replace(tree=found[number].tree)))
            if len(proven) == MOST_POLISHED:
                break
        return min(proven, key=lambda one: one[:2])[2] if proven else Failure(reason, nearest)

    def query(self, start: Float[np.ndarray, " state"], goal: Goal) -> Query:
        """What a planner is given: one instance of the problem."""
        regulator = Regulator(self.simulator, goal, self.weights, self.config.regulator)
        return Query(self.problem, start, goal, self.simulator, regulator, self.config.metric)

    def _draw(self, rng: np.random.Generator) -> tuple[np.ndarray, Goal]:
        """A start and a goal; the start does not lie in the goal region."""
        start = self.problem.draw_start(self.simulator, rng)
        goal = at_rest(self.simulator, self.problem.draw_goal(self.space, rng, self.simulator))
        for _ in range(MAX_REDRAWS):
            if not goal.reached(start):
                break
            start = self.problem.draw_start(self.simulator, rng)
        return start, goal

    def _prove(self, query: Query, found: Plan | Failure, rng: np.random.Generator) -> Trajectory | Failure:
        """The first way to end a path that passes the proof, shortened by simulation if it has contacts."""
        failure = found if isinstance(found, Failure) else Failure("the planner returned an empty path")
        for controls in self._endings(query, found):
            plan = replay_plan(query, controls)
            if isinstance(plan, Trajectory):
                return self._shortened(query, plan, rng)
            failure = Failure(plan.reason, min(failure.nearest, plan.nearest))
        return failure

    def _shortened(self, query: Query, plan: Trajectory, rng: np.random.Generator) -> Trajectory:
        config = self.config.polish
        wanted = config.max_iterations and config.shortcut_rounds and self.problem.cost == "duration"
        if not wanted or not has_contacts(query, plan.controls):
            return plan
        own = rng.spawn(1)[0]  # the next search draws the same numbers with and without shortcuts
        controls = Shortcut(self.simulator, query.goal, config, own).run(query.start, plan.controls)
        shorter = plan if controls is None else replay_plan(query, controls)
        return shorter if isinstance(shorter, Trajectory) else plan

    def _endings(self, query: Query, found: Plan | Failure) -> Iterator[np.ndarray]:
        """Ways to end a path, the shortest first; each is tried only if those before it fail.

        If the goal is entered too fast to be held, the next way lands deeper in it, with some more steps.
        """
        if found.controls is None or len(found.controls) == 0:
            return
        effort, guess = self.problem.cost == "effort", found.controls
        for landing in LANDINGS if self.config.polish.max_iterations else ():
            config = replace(self.config.polish, landing=landing * self.config.polish.landing)
            polish = Polish(
                self.simulator, query.goal, self.weights, config, clearance=self.clearance, effort=effort
            )
            controls = polish.run(query.start, guess)
            if controls is None:
                break
            yield controls
            guess = np.concatenate([controls, _regulated_steps(query, controls)])
        if isinstance(found, Plan):
            yield found.controls

    def _stored(self, plan: Trajectory, goal: Goal) -> Trajectory | Failure:
        """The plan with angles that end in (-pi, pi], proved again from its stored start."""
        states = _continuous(self.space, plan.states)
        if np.array_equal(states, plan.states):
            return plan
        again = replay_plan(self.query(states[0], goal), plan.controls)
        if isinstance(again, Trajectory) and len(again.states) == len(states):
            close = np.abs(again.states - states).max() < SAME_STATES
            return Trajectory(states if close else again.states, plan.controls, plan.tree)
        return again if isinstance(again, Failure) else again._replace(tree=plan.tree)

    def _episode(self, plan: Trajectory, goal: Goal, index: int, attempt: int) -> Episode:
        times = np.arange(len(plan.states)) * self.model.opt.timestep
        return Episode(
            plan.states,
            plan.controls,
            times,
            goal.center,
            True,
            index=index,
            seed=attempt,
            cost=self._cost(plan),
        )

    def _with_tree(self, episode: Episode, tree: SearchTree | None, seed: int) -> Episode:
        """The episode with its search tree, which starts at the stored start and has a bounded size."""
        if tree is None:
            raise UsageError(
                f"Planner {name_of(self.config.planner)} returned no search tree; plan without keep_trees. "
                f"See {PAGE}."
            )
        own = np.random.default_rng(np.random.SeedSequence([seed, episode.index, episode.seed, TREE_STREAM]))
        thinned = tree.thin(self.config.tree_nodes, own)
        states = _same_windings(self.space, thinned.states, episode.states[0])
        return replace(episode, tree=replace(thinned, states=states))

    def _path_cost(self, found: Plan | Failure) -> float:
        """The cost of a path before it is polished; a path that does not arrive comes last."""
        return np.inf if isinstance(found, Failure) else self._cost(found)

    def _cost(self, plan: Plan | Trajectory) -> float:
        return float(self.problem.step_cost(self.simulator, plan.controls).sum())


def _regulated_steps(query: Query, controls: np.ndarray) -> np.ndarray:
    """What the regulator does in the steps after a plan."""
    data = mujoco.MjData(query.model)
    query.space.write_data(query.start, data)
    state = query.start
    for control in controls:
        state = advance(query.model, data, query.space, control)
    stride, more = query.regulator.stride, []
    for _ in range(num_steps(DEEPER_S, query.model) // stride):
        more.append(query.regulator.control(state))
        state = advance(query.model, data, query.space, more[-1], stride)
    return np.repeat(np.stack(more), stride, axis=0)


def _same_windings(space: StateSpace, states: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The states of a tree with the windings and signs with which its start is stored."""
    states = states.copy()
    for column in space.circular_columns:
        states[:, column] += start[column] - states[0, column]
    for column in space.quaternion_columns:
        if states[0, column : column + 4] @ start[column : column + 4] < 0:
            states[:, column : column + 4] *= -1.0
    states[0] = start
    return states


def _continuous(space: StateSpace, states: np.ndarray) -> np.ndarray:
    """The states without jumps: angles end in (-pi, pi], quaternions end with w >= 0."""
    states = states.copy()
    for column in space.circular_columns:
        states[:, column] = unwrap_to_end(states[:, column])
    for column in space.quaternion_columns:
        if states[-1, column] < 0:
            states[:, column : column + 4] *= -1.0
    return states
