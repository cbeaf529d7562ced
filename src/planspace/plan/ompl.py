"""The same problems through OMPL's planners, MuJoCo propagating and checking their states (extra `ompl`).

Control planners (SST, RRT, EST, KPIECE1, PDST) for problems with dynamics, geometric ones (RRT-Connect, RRT*,
PRM, BIT*) for kinematic ones. Every plan runs in a process of its own: OMPL's random state belongs to the
process and can be seeded once, and its bindings can crash, which then costs one plan.

Angles are wrapped after every propagation: OMPL's distances on a circle assume it, and without it they go
negative. States carry the time they were reached, so that SST minimises duration; OMPL's own default is the
length of the path in state space.
"""

import importlib.metadata
import importlib.util
import itertools
import multiprocessing
import multiprocessing.connection
import os
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from planspace.errors import PlanspaceError, UsageError
from planspace.physics import quaternion
from planspace.physics.angles import wrap
from planspace.physics.simulate import FREE, Simulator, advance
from planspace.physics.space import StateSpace
from planspace.plan.problem import Goal, Problem

if TYPE_CHECKING:
    from planspace.plan.sst import Search

CONTROL_PLANNERS = {
    "ompl-sst": "SST",
    "ompl-rrt": "RRT",
    "ompl-est": "EST",
    "ompl-kpiece1": "KPIECE1",
    "ompl-pdst": "PDST",
}
GEOMETRIC_PLANNERS = {
    "ompl-rrtconnect": "RRTConnect",
    "ompl-rrtstar": "RRTstar",
    "ompl-prm": "PRM",
    "ompl-bitstar": "BITstar",
}
OMPL_PLANNERS = (*CONTROL_PLANNERS, *GEOMETRIC_PLANNERS)
VERSION = "1.7.0"
"""The last version whose Python bindings can construct every planner named here."""
PROJECTION_DIMENSIONS = 3
PROJECTION_CELLS = 20
"""Cells a dimension in the projection that KPIECE1, EST and PDST explore by."""
GRACE_S = 60.0
"""A planner's process is stopped this long [s] after its time was up."""


@dataclass(frozen=True)
class OMPLConfig:
    """Settings of OMPL's planners."""

    seconds: float = 20.0
    """Time for each plan [s]. Planners that improve their plans use all of it."""
    iterations: int = 0
    """If positive, stop after so many iterations instead: reproducible where the planner is."""
    goal_bias: float = 0.1
    """Share of samples at the goal, where the planner has one."""
    selection_radius: float = 0.3
    """SST's selection radius, in the weighted distance of neighbour search (2020: 0.002, unit weights)."""
    pruning_radius: float = 0.08
    """SST's pruning radius (2020: 0.0005)."""
    max_edge_steps: int = 10
    """An edge holds its control for 1 to this many physics steps."""


def check_ompl(planner: str, problem: Problem) -> None:
    """Checks that a planner can be used on a problem.

    Raises:
        UsageError: it is not for this kind of problem.
        PlanspaceError: OMPL is missing, or a version that cannot construct this planner.
    """
    wanted = GEOMETRIC_PLANNERS if problem.kinematic else CONTROL_PLANNERS
    if planner not in wanted:
        kind = "kinematic" if problem.kinematic else "dynamic"
        raise UsageError(f"{planner} cannot plan a {kind} problem; {', '.join(['sst', *wanted])} can.")
    if importlib.util.find_spec("ompl") is None:
        raise PlanspaceError("OMPL is not installed: pip install 'planspace[ompl]'.")
    version = importlib.metadata.version("ompl")
    if not version.startswith("1.") and planner in ("ompl-sst", "ompl-pdst"):
        raise PlanspaceError(
            f"the Python bindings of OMPL {version} cannot construct SST and PDST; RRT, EST and KPIECE1 "
            f"they can. All are in {VERSION}: pip install 'ompl=={VERSION}'."
        )


def plan_in_process(
    problem: Problem, planner: str, config: OMPLConfig, start: np.ndarray, goal: Goal, seed: int
) -> "Search":
    """Plans once, in a process that may crash.

    Args:
        problem: what to plan.
        planner: one of `OMPL_PLANNERS`.
        config: settings.
        start: where from.
        goal: where to.
        seed: OMPL's seed, from 1.

    Returns:
        What came of it; after a crash, nothing found and a note that says so.
    """
    from planspace.plan.sst import Search

    context = multiprocessing.get_context("spawn")
    receive, send = context.Pipe(duplex=False)
    box = (goal.center, goal.half, goal.weights, goal.tolerance)
    process = context.Process(target=_child, args=(send, problem, planner, config, start, box, seed))
    process.start()
    send.close()
    patience = GRACE_S + (config.seconds if not config.iterations else 3600.0)
    answer: dict[str, Any] | None = None
    try:
        if receive.poll(patience):
            answer = receive.recv()
    except EOFError:
        answer = None  # it died without a word
    process.join(5.0)
    if process.is_alive():
        process.kill()
        process.join()
    controls = np.empty((0, len(_control_names(problem))))
    if answer is None or "crash" in answer:
        why = f"exit code {process.exitcode}" if answer is None else answer["crash"]
        note = f"{planner} crashed ({why})"
        print(f"planspace: {note}; this costs one plan.", file=sys.stderr)
        return Search(controls, False, np.inf, float(goal.distance(start)), 0, 0, note)
    if "error" in answer:
        raise PlanspaceError(f"{planner}: {answer['error']}")
    return Search(
        controls=np.asarray(answer["controls"]),
        arrived=answer["arrived"],
        cost=answer["duration"],
        nearest=answer["nearest"],
        nodes=0,
        simulated_steps=answer["steps"],
        note="" if answer["arrived"] else f"{planner} found no path in its time",
    )


def _control_names(problem: Problem) -> list[int]:
    model, space = problem.compile()
    return list(range(space.num_dofs if space.kinematic else model.nu))


def _child(
    send: multiprocessing.connection.Connection,
    problem: Problem,
    planner: str,
    config: OMPLConfig,
    start: np.ndarray,
    box: tuple[np.ndarray, np.ndarray, np.ndarray, float],
    seed: int,
) -> None:
    """Runs in the process: plans, answers, and leaves at once, before OMPL's destructors can crash."""
    with open(os.devnull, "w") as quiet:
        os.dup2(quiet.fileno(), 1)
    try:
        model, space = problem.compile()
        goal = Goal(space, *box)
        simulator = Simulator(model, space, 1, threads=1, validity=problem.validity)
        query = _Query(problem, simulator, goal, config)
        send.send(query.solve(planner, start, seed))
    except PlanspaceError as error:
        send.send({"error": str(error)})
    except Exception as error:  # of OMPL or its bindings: it costs this plan
        send.send({"crash": f"{type(error).__name__}: {' '.join(str(error).split())}"})
    send.close()
    os._exit(0)


class _Query:
    """One query in OMPL's terms."""

    def __init__(self, problem: Problem, simulator: Simulator, goal: Goal, config: OMPLConfig):
        from ompl import base, util

        util.setLogLevel(util.LOG_ERROR)
        self.base, self.problem, self.simulator, self.goal = base, problem, simulator, goal
        self.config, self.space = config, simulator.space
        self.dt = simulator.model.opt.timestep
        self.steps, self.nearest = 0, np.inf
        self.parts = _parts(self.space)
        self.ompl_space = self._state_space()

    def solve(self, planner: str, start: np.ndarray, seed: int) -> dict[str, Any]:
        """Runs a planner; the answer is plain data."""
        from ompl import util

        util.RNG.setSeed(seed)
        if self.space.kinematic:
            controls, arrived = self._solve_geometric(GEOMETRIC_PLANNERS[planner], start)
        else:
            controls, arrived = self._solve_control(CONTROL_PLANNERS[planner], start)
        return {
            "arrived": arrived,
            "controls": controls,
            "duration": len(controls) * self.dt if arrived else np.inf,
            "nearest": float(self.nearest),
            "steps": self.steps,
        }

    # --- states -----------------------------------------------------------------------------------------

    def _state_space(self) -> Any:
        """One subspace a part, weighted as neighbours are in ours, and the time at the end."""
        base, weights = self.base, self.problem.weights(self.space)
        space = base.CompoundStateSpace()
        speed = self.problem.speed(self.space)
        for s, t, kind in self.parts:
            if kind == "circle":
                part = base.SO2StateSpace()
            elif kind == "rotation":
                part = base.SO3StateSpace()
            else:
                part = base.RealVectorStateSpace(1)
                bounds = base.RealVectorBounds(1)
                positions = self.space.num_positions
                reach = speed[t - self.space.num_dofs] if s >= positions else 0.0
                bounds.setLow(float(self.space.low[s] if s < positions else -reach))
                bounds.setHigh(float(self.space.high[s] if s < positions else reach))
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
        """A state of OMPL as ours."""
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
        """Our state into one of OMPL's, angles wrapped."""
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
        if self.simulator.validity == FREE:  # the bounds alone, without a simulation
            return bool(self.space.in_bounds(x))
        return bool(self.simulator.valid_states(x[None])[0])

    def distance(self, state: Any) -> float:
        """How far a state is from the goal."""
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
        information.setMinMaxControlDuration(1, self.config.max_edge_steps)
        model, data = simulator.model, mujoco.MjData(simulator.model)

        def propagate(before: Any, action: Any, duration: float, after: Any) -> None:
            steps = max(1, round(duration / self.dt))
            self.space.write(self.read(before), data.qpos, data.qvel)
            data.qacc_warmstart[:] = 0.0
            reached = advance(model, data, self.space, np.array([action[i] for i in range(size)]), steps)
            self.steps += steps
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
            planner.setGoalBias(self.config.goal_bias)
        if name == "SST":
            planner.setSelectionRadius(self.config.selection_radius)
            planner.setPruningRadius(self.config.pruning_radius)
        self._planner = planner
        setup.setPlanner(planner)

    def _run(self, setup: Any) -> bool:
        if self.config.iterations:
            counted = self.base.IterationTerminationCondition(self.config.iterations)
            setup.solve(self.base.PlannerTerminationCondition(counted))
        else:
            setup.solve(self.config.seconds)
        return bool(setup.haveExactSolutionPath())


def _goal_region(query: _Query, information: Any) -> Any:
    """Our goal as a region OMPL can sample."""

    class Region(query.base.GoalSampleableRegion):  # made here: the base class exists only with OMPL
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


def _duration(query: _Query, information: Any) -> Any:
    """The objective: the time between two states, for a straight motion what the velocity bounds allow."""

    class Duration(query.base.OptimizationObjective):
        def motionCost(self, before: Any, after: Any) -> Any:
            if not query.space.kinematic:
                return query.base.Cost(abs(query.clock(after) - query.clock(before)))
            way = np.abs(query.space.difference(query.read(after), query.read(before)))
            return query.base.Cost(float((way / query.space.velocity_bound).max()))

        def stateCost(self, state: Any) -> Any:
            return query.base.Cost(0.0)

    return Duration(information)


def _projection(query: _Query, space: Any) -> Any:
    """The first few positions."""
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


def _parts(space: StateSpace) -> list[tuple[int, int, str]]:
    return list(space.layout)


def _velocities(space: StateSpace, corners: list[np.ndarray], dt: float) -> np.ndarray:
    """The velocities that lead along a path from corner to corner, as fast as the bounds allow."""
    controls = []
    for a, b in itertools.pairwise(corners):
        way = space.difference(b, a)
        steps = max(1, int(np.ceil((np.abs(way) / space.velocity_bound).max() / dt)))
        controls += [way / (steps * dt)] * steps
    return np.array(controls).reshape(len(controls), space.num_dofs)
