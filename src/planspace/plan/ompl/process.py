"""A search with OMPL, in a process of its own: MuJoCo propagates and checks the states (extra `ompl`).

Every search runs in a separate process: OMPL's random state belongs to the process and can be seeded only
once, and its bindings can crash, which then costs one search.
"""

import multiprocessing
import multiprocessing.connection
import os
import sys

import numpy as np

from planspace.errors import PlanspaceError
from planspace.physics.simulator import Simulator
from planspace.plan.ompl.planners import OMPL
from planspace.plan.planner import Failure, Plan
from planspace.plan.query import Query
from planspace.tasks.problem import Goal, Problem
from planspace.workers import exit_with_parent

GRACE_S = 60.0
"""A process is killed this many seconds after its time was up."""
COUNTED_S = 3600.0
"""Time for a search that counts iterations instead [s]."""


def plan_in_process(planner: OMPL, query: Query, *, seed: int) -> Plan | Failure:
    """Search once, in a process that may crash.

    Args:
        planner: the planner and its settings.
        query: start and goal.
        seed: OMPL's seed, at least 1.

    Returns:
        The plan, or why there is none. A crash is a failure, and is also reported on standard error.
    """
    context = multiprocessing.get_context("spawn")
    receive, send = context.Pipe(duplex=False)
    goal = (query.goal.center, query.goal.half, query.goal.weights, query.goal.tolerance)
    process = context.Process(target=_child, args=(send, query.problem, planner, query.start, goal, seed))
    process.start()
    send.close()
    patience = GRACE_S + (COUNTED_S if planner.iterations else planner.seconds)
    answer: Plan | Failure | PlanspaceError | str | None = None
    try:
        answer = receive.recv() if receive.poll(patience) else "it exceeded its time"
    except EOFError:
        answer = None  # it died without an answer
    finally:
        receive.close()
    process.join(5.0)
    if process.is_alive():
        process.kill()
        process.join()
    if isinstance(answer, PlanspaceError):
        raise answer
    if isinstance(answer, Plan | Failure):
        return answer
    note = f"{planner.name} crashed ({answer or f'exit code {process.exitcode}'})"
    print(f"planspace: {note}; this costs one plan.", file=sys.stderr)
    return Failure(note, float(query.goal.distance(query.start)))


def _child(
    send: multiprocessing.connection.Connection,
    problem: Problem,
    planner: OMPL,
    start: np.ndarray,
    goal: tuple[np.ndarray, np.ndarray, np.ndarray, float],
    seed: int,
) -> None:
    """Run in the process: search, answer, and leave at once, before OMPL's destructors can crash."""
    exit_with_parent()
    with open(os.devnull, "w") as quiet:
        os.dup2(quiet.fileno(), 1)
    try:
        from planspace.plan.ompl.ompl_query import OMPLQuery  # needs OMPL, which only this process loads

        model, space = problem.compile()
        simulator = Simulator(model, space, 1, threads=1, validity=problem.validity)
        query = OMPLQuery(problem, simulator, Goal(space, *goal), planner)
        send.send(query.solve(start, seed))
    except PlanspaceError as error:
        send.send(type(error)(f"{planner.name}: {error}"))
    except Exception as error:  # from OMPL or its bindings: it costs this search
        send.send(f"{type(error).__name__}: {' '.join(str(error).split())}")
    send.close()
    os._exit(0)
