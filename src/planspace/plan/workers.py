"""Plans made in worker processes."""

import pickle
from collections.abc import Generator
from functools import lru_cache
from typing import NamedTuple

from planspace.demos.episode import Episode
from planspace.errors import PlanspaceError, UsageError
from planspace.physics.step_count import steps_taken
from planspace.plan.config import PlanConfig
from planspace.plan.pipeline import Pipeline
from planspace.plan.planner import PAGE, Failure
from planspace.seams import name_of
from planspace.tasks.problem import Problem
from planspace.workers import WORKER_ENVIRONMENT, WorkerDied, WorkerPool, count_cores, pack

ADVICE = f"Put the planner in a module of its own, or plan with workers=0. See {PAGE}."


class Planned(NamedTuple):
    """A plan, or why there is none, and what it took."""

    found: Episode | Failure
    simulated_steps: int | None
    """Physics steps of all simulations: of searching, polishing and proving, failed attempts included. None
    for a planner that searches in another process."""


def plan_all(
    problem: Problem, config: PlanConfig, seed: int, indices: range, workers: int | None
) -> Generator[Planned, None, None]:
    """Plan demonstrations and yield them in order.

    Args:
        problem: what to plan.
        config: planner, polish and regulator.
        seed: seed of all of them.
        indices: their numbers.
        workers: number of processes; 0 for this one, None for one for each CPU.
    """
    if workers == 0:
        pipeline = Pipeline(problem, config)
        for i in indices:
            yield _plan(pipeline, seed, i)
        return
    packed = _pack(problem, config)
    workers = min(workers or count_cores(), len(indices))
    with WorkerPool(workers, WORKER_ENVIRONMENT) as pool:
        futures = [pool.submit(_plan_packed, packed, seed, i) for i in indices]
        try:
            for future in futures:
                yield future.result()
        except WorkerDied as error:
            raise PlanspaceError(
                f"a worker process ended unexpectedly ({error}) while planning with "
                f"{name_of(config.planner)}; workers=0 plans without processes."
            ) from error


def check_workers(problem: Problem, config: PlanConfig, workers: int | None) -> None:
    """Refuse a planner that cannot be sent to worker processes, before anything is written.

    Raises:
        UsageError: the planner cannot be sent to another process.
    """
    if workers != 0:
        _pack(problem, config)


def _pack(problem: Problem, config: PlanConfig) -> bytes:
    """What a worker needs."""
    try:
        return pack((problem, config))
    except Exception as error:  # of the user's object
        raise UsageError(
            f"the planner {name_of(config.planner)} cannot be sent to worker processes: "
            f"{type(error).__name__}: {error}. {ADVICE}"
        ) from error


def _plan_packed(packed: bytes, seed: int, index: int) -> Planned:
    """Plan one demonstration in a worker."""
    return _plan(_pipeline(packed), seed, index)


def _plan(pipeline: Pipeline, seed: int, index: int) -> Planned:
    """Plan one demonstration, and count the simulated steps."""
    before = steps_taken()
    found = pipeline.plan(seed, index)
    elsewhere = getattr(pipeline.config.planner, "searches_elsewhere", False)
    return Planned(found, None if elsewhere else steps_taken() - before)


@lru_cache(maxsize=2)
def _pipeline(packed: bytes) -> Pipeline:
    try:
        problem, config = pickle.loads(packed)
    except Exception as error:  # the user's module cannot be imported here
        raise UsageError(
            f"worker processes cannot import the planner: {type(error).__name__}: {error}. {ADVICE}"
        ) from None
    return Pipeline(problem, config)
