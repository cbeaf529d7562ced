"""A search with OMPL, in a process of its own: MuJoCo propagates and checks the states (extra `ompl`).

Every search runs in a separate process: OMPL's random state belongs to the process and can be seeded only
once, and its bindings can crash, which then costs one search.
"""

import os
import sys
from typing import Any

import numpy as np

from planspace.errors import PlanspaceError
from planspace.physics.simulator import Simulator
from planspace.plan.ompl.planners import OMPL
from planspace.plan.planner import Failure, Plan
from planspace.plan.query import Query
from planspace.tasks.problem import Goal, Problem
from planspace.workers import WorkerDied, WorkerPool

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
    goal = (query.goal.center, query.goal.half, query.goal.weights, query.goal.tolerance)
    patience = GRACE_S + (COUNTED_S if planner.iterations else planner.seconds)
    with WorkerPool(1) as pool:
        try:
            answer = pool.submit(_search, query.problem, planner, query.start, goal, seed).result(patience)
        except WorkerDied as error:
            answer = str(error)
        except TimeoutError:
            answer = "it exceeded its time"
    if isinstance(answer, Plan | Failure):
        return answer
    note = f"{planner.name} crashed ({answer})"
    print(f"planspace: {note}; this costs one plan.", file=sys.stderr)
    return Failure(note, float(query.goal.distance(query.start)))


def _search(
    problem: Problem,
    planner: OMPL,
    start: np.ndarray,
    goal: tuple[np.ndarray, np.ndarray, np.ndarray, float],
    seed: int,
) -> Plan | Failure | str:
    """Search in the process.

    Returns:
        The plan, or why there is none; a text if OMPL or its bindings raised an error.
    """
    with open(os.devnull, "w") as quiet:
        os.dup2(quiet.fileno(), 1)
    try:
        from planspace.plan.ompl.ompl_query import OMPLQuery  # needs OMPL, which only this process loads

        model, space = problem.compile()
        simulator = Simulator(model, space, 1, threads=1, validity=problem.validity)
        query = OMPLQuery(problem, simulator, Goal(space, *goal), planner)
        _kept.append(query)
        return query.solve(start, seed)
    except PlanspaceError as error:
        raise type(error)(f"{planner.name}: {error}") from None
    except Exception as error:  # from OMPL or its bindings: it costs this search
        return f"{type(error).__name__}: {' '.join(str(error).split())}"


_kept: list[Any] = []
"""The query, kept until the process is killed: OMPL's destructors can crash."""
