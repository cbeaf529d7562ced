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
import multiprocessing
import multiprocessing.connection
import os
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from planspace.errors import PlanspaceError, UsageError
from planspace.physics.simulator import Simulator
from planspace.tasks.problem import Goal, Problem
from planspace.workers import end_with_parent

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
    min_edge_steps: int = 1
    """An edge holds its control for at least this many physics steps ..."""
    max_edge_steps: int = 10
    """... and at most this many."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if not (self.seconds > 0 and self.iterations >= 0 and 0 <= self.goal_bias <= 1):
            raise ValueError("ompl_seconds must be positive, ompl_goal_bias lie in [0, 1]")
        if not 1 <= self.min_edge_steps <= self.max_edge_steps:
            raise ValueError("ompl_min_edge_steps must lie between 1 and ompl_max_edge_steps")


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
    arguments = (send, problem, planner, config, start, box, seed)
    process = context.Process(target=_child, args=arguments)
    process.start()
    send.close()
    patience = GRACE_S + (config.seconds if not config.iterations else 3600.0)
    answer: dict[str, Any] | None = None
    try:
        answer = receive.recv() if receive.poll(patience) else {"crash": "it overran its time"}
    except EOFError:
        answer = None  # it died without a word
    finally:
        receive.close()
    process.join(5.0)
    if process.is_alive():
        process.kill()
        process.join()
    if answer is None or "crash" in answer:
        why = f"exit code {process.exitcode}" if answer is None else answer["crash"]
        note = f"{planner} crashed ({why})"
        print(f"planspace: {note}; this costs one plan.", file=sys.stderr)
        nothing = np.empty((0, 0))
        return Search(nothing, False, np.inf, float(goal.distance(start)), 0, 0, note)
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
    end_with_parent()
    with open(os.devnull, "w") as quiet:
        os.dup2(quiet.fileno(), 1)
    try:
        from planspace.plan.ompl_query import Query  # needs OMPL, which only this process loads

        model, space = problem.compile()
        goal = Goal(space, *box)
        simulator = Simulator(model, space, 1, threads=1, validity=problem.validity)
        query = Query(problem, simulator, goal, config)
        send.send(query.solve(planner, start, seed))
    except PlanspaceError as error:
        send.send({"error": str(error)})
    except Exception as error:  # of OMPL or its bindings: it costs this plan
        send.send({"crash": f"{type(error).__name__}: {' '.join(str(error).split())}"})
    send.close()
    os._exit(0)
