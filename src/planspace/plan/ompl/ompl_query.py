"""A query in OMPL's terms: spaces, states, propagation, goal and objective.

Angles are wrapped after every propagation, because OMPL's distances on a circle assume it and become negative
otherwise. States carry the time at which they were reached, so that SST minimises the duration; by default it
minimises the length of the path in state space.
"""

import itertools
from typing import Any

import mujoco
import numpy as np

from planspace.physics import quaternion
from planspace.physics.angles import wrap
from planspace.physics.replay import advance
from planspace.physics.simulator import FREE, Simulator
from planspace.physics.space import StateSpace
from planspace.plan.durations import num_steps
from planspace.plan.ompl.planners import OMPL
from planspace.plan.planner import Failure, Plan
from planspace.tasks.problem import Goal, Problem

PROJECTION_DIMENSIONS = 3
PROJECTION_CELLS = 20
"""Cells per dimension of the projection that guides KPIECE1, EST and PDST."""


class OMPLQuery:
    """A query in OMPL's terms."""

    def __init__(self, problem: Problem, simulator: Simulator, goal: Goal, planner: OMPL):
        from ompl import base, util

        util.setLogLevel(util.LOG_ERROR)
        self.base, self.problem, self.simulator, self.goal = base, problem, simulator, goal
        self.planner, self.space = planner, simulator.space
        self.dt = simulator.model.opt.timestep
        self.nearest = np.inf
        self.parts = self.space.layout
        self.ompl_space = self._state_space()

    def solve(self, start: np.ndarray, seed: int) -> Plan | Failure:
        """Search with the planner."""
        from ompl import util

        util.RNG.setSeed(seed)
        self.nearest = float(self.goal.distance(start))
        solve = self._solve_geometric if self.space.kinematic else self._solve_control
        controls, arrived = solve(self.planner.algorithm, start)
        if arrived:
            return Plan(controls)
        return Failure(f"{self.planner.name} found no path in its time", float(self.nearest), controls)

    # --- states -----------------------------------------------------------------------------------------

    def _state_space(self) -> Any:
        """One subspace per part of the state, weighted as in our neighbour search; then the time."""
        base, weights = self.base, self.problem.weights(self.space)
        space = base.CompoundStateSpace()
        low, high = self.space.ranges(self.problem.speed(self.space))
        for s, t, kind in self.parts:
            if kind == "circle":
                part = base.SO2StateSpace()
            elif kind == "rotation":
                part = base.SO3StateSpace()
            else:
                part = base.RealVectorStateSpace(1)
                bounds = base.RealVectorBounds(1)
                bounds.setLow(float(low[s]))
                bounds.setHigh(float(high[s]))
                part.setBounds(bounds)
            space.addSubspace(part, float(weights[t]))
        clock = base.RealVectorStateSpace(1)
        bounds = base.RealVectorBounds(1)
        bounds.setLow(0.0)
        bounds.setHigh(1e6)
        clock.setBounds(bounds)
        space.addSubspace(clock, 0.0)
        return space

    def read(self, state: Any) -> np.ndarray:
        """Convert a state of OMPL to ours."""
        x = np.empty(self.space.size)
        for part, (s, _, kind) in enumerate(self.parts):
            value = state[part]
            if kind == "circle":
                x[s] = value.value
            elif kind == "rotation":
                x[s : s + 4] = value.w, value.x, value.y, value.z
            else:
                x[s] = value[0]
        return x

    def write(self, x: np.ndarray, clock: float, state: Any) -> None:
        """Write our state into one of OMPL's; angles are wrapped."""
        for part, (s, _, kind) in enumerate(self.parts):
            value = state[part]
            if kind == "circle":
                value.value = float(wrap(x[s]))
            elif kind == "rotation":
                value.w, value.x, value.y, value.z = (float(q) for q in quaternion.normalise(x[s : s + 4]))
            else:
                value[0] = float(x[s])
        state[len(self.parts)][0] = clock

    def clock(self, state: Any) -> float:
        """The time at which a state was reached [s]."""
        return float(state[len(self.parts)][0])

    def valid(self, state: Any) -> bool:
        """OMPL's validity checker."""
        x = self.read(state)
        if self.simulator.validity == FREE:  # only the bounds matter, which needs no simulation
            return bool(self.space.in_bounds(x))
        return bool(self.simulator.valid_states(x[None])[0])

    def distance(self, state: Any) -> float:
        """Distance of a state to the goal; the smallest is kept in `nearest`."""
        distance = float(self.goal.distance(self.read(state)))
        self.nearest = min(self.nearest, distance)
        return distance

    # --- the two kinds of problem -----------------------------------------------------------------------

    def _solve_control(self, name: str, start: np.ndarray) -> tuple[np.ndarray, bool]:
        from ompl import control

        base, simulator = self.base, self.simulator
        size = len(simulator.control_low)
        controls = control.RealVectorControlSpace(self.ompl_space, size)
        bounds = base.RealVectorBounds(size)
        for i in range(size):
            bounds.setLow(i, float(simulator.control_low[i]))
            bounds.setHigh(i, float(simulator.control_high[i]))
        controls.setBounds(bounds)
        setup = control.SimpleSetup(controls)
        information = setup.getSpaceInformation()
        information.setPropagationStepSize(self.dt)
        edges = (self.planner.min_edge_s, self.planner.max_edge_s)
        information.setMinMaxControlDuration(*(num_steps(seconds, simulator.model) for seconds in edges))
        model, data = simulator.model, mujoco.MjData(simulator.model)

        def propagate(before: Any, action: Any, duration: float, after: Any) -> None:
            steps = max(1, round(duration / self.dt))
            self.space.write_data(self.read(before), data)
            data.qacc_warmstart[:] = 0.0
            reached = advance(model, data, self.space, np.array([action[i] for i in range(size)]), steps)
            self.write(reached, self.clock(before) + steps * self.dt, after)

        setup.setStatePropagator(control.StatePropagatorFn(propagate))
        self._prepare(setup, start, control, name)
        arrived = self._run(setup)
        if not setup.haveSolutionPath():
            return np.empty((0, size)), False
        path = setup.getSolutionPath()
        edges = range(path.getControlCount())
        held = [max(1, round(path.getControlDuration(i) / self.dt)) for i in edges]
        actions = [[path.getControl(i)[k] for k in range(size)] for i in edges]
        return np.repeat(np.array(actions).reshape(len(held), size), held, axis=0), arrived

    def _solve_geometric(self, name: str, start: np.ndarray) -> tuple[np.ndarray, bool]:
        from ompl import geometric

        setup = geometric.SimpleSetup(self.ompl_space)
        self._prepare(setup, start, geometric, name)
        setup.getSpaceInformation().setStateValidityCheckingResolution(0.005)
        if not self._run(setup):
            return np.empty((0, self.space.num_dofs)), False
        setup.simplifySolution()
        path = setup.getSolutionPath()
        corners = [self.read(path.getState(i)) for i in range(path.getStateCount())]
        return _velocities(self.space, corners, self.dt), True

    def _prepare(self, setup: Any, start: np.ndarray, module: Any, name: str) -> None:
        base = self.base
        setup.setStateValidityChecker(base.StateValidityCheckerFn(self.valid))
        state = base.State(self.ompl_space)
        self.write(start, 0.0, state())
        setup.setStartState(state)
        self._goal = _goal_region(self, setup.getSpaceInformation())
        setup.setGoal(self._goal)
        self._objective = _duration(self, setup.getSpaceInformation())
        setup.setOptimizationObjective(self._objective)
        self._projection = _projection(self, self.ompl_space)
        self.ompl_space.registerDefaultProjection(self._projection)
        planner = getattr(module, name)(setup.getSpaceInformation())
        if hasattr(planner, "setGoalBias"):
            planner.setGoalBias(self.planner.goal_bias)
        if name == "SST":
            planner.setSelectionRadius(self.planner.selection_radius)
            planner.setPruningRadius(self.planner.pruning_radius)
        self._ompl_planner = planner
        setup.setPlanner(planner)

    def _run(self, setup: Any) -> bool:
        if self.planner.iterations:
            asked, last = itertools.count(1), self.planner.iterations
            self._is_over = self.base.PlannerTerminationConditionFn(lambda: next(asked) > last)
            setup.solve(self.base.PlannerTerminationCondition(self._is_over))
        else:
            setup.solve(self.planner.seconds)
        return bool(setup.haveExactSolutionPath())


def _goal_region(query: OMPLQuery, information: Any) -> Any:
    """Our goal as a region that OMPL can sample."""

    class Region(query.base.GoalSampleableRegion):  # defined here, because the base class needs OMPL
        def __init__(self) -> None:
            super().__init__(information)
            self.setThreshold(query.goal.tolerance)

        def distanceGoal(self, state: Any) -> float:
            return query.distance(state)

        def sampleGoal(self, state: Any) -> None:
            query.write(query.goal.center, 0.0, state)

        def maxSampleCount(self) -> int:
            return 1

    return Region()


def _duration(query: OMPLQuery, information: Any) -> Any:
    """The objective: the time between two states, or of a straight motion at the velocity bounds."""

    class Duration(query.base.OptimizationObjective):
        def motionCost(self, before: Any, after: Any) -> Any:
            if not query.space.kinematic:
                return query.base.Cost(abs(query.clock(after) - query.clock(before)))
            way = np.abs(query.space.difference(query.read(after), query.read(before)))
            return query.base.Cost(float((way / query.space.velocity_bound).max()))

        def stateCost(self, state: Any) -> Any:
            return query.base.Cost(0.0)

    return Duration(information)


def _projection(query: OMPLQuery, space: Any) -> Any:
    """The projection on the first few positions."""
    from ompl import util

    columns = [s for s, _, kind in query.parts if kind != "rotation"][:PROJECTION_DIMENSIONS]

    class Positions(query.base.ProjectionEvaluator):
        def __init__(self) -> None:
            super().__init__(space)
            widths = [
                query.space.high[s] - query.space.low[s] if s < len(query.space.low) else 2.0 for s in columns
            ]
            widths = [w if np.isfinite(w) else 2.0 * np.pi for w in widths]
            cells = util.vectorDouble()
            cells.extend([float(w) / PROJECTION_CELLS for w in widths])
            self.setCellSizes(cells)

        def getDimension(self) -> int:
            return len(columns)

        def project(self, state: Any, projection: Any) -> None:
            x = query.read(state)
            for i, column in enumerate(columns):
                projection[i] = float(x[column])

    return Positions()


def _velocities(space: StateSpace, corners: list[np.ndarray], dt: float) -> np.ndarray:
    """Velocities that follow a path from corner to corner, as fast as the bounds allow."""
    controls = []
    for a, b in itertools.pairwise(corners):
        way = space.difference(b, a)
        steps = max(1, int(np.ceil((np.abs(way) / space.velocity_bound).max() / dt)))
        controls += [way / (steps * dt)] * steps
    return np.array(controls).reshape(len(controls), space.num_dofs)
