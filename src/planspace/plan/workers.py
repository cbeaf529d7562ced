"""Plans made in worker processes."""

import multiprocessing
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from multiprocessing.reduction import ForkingPickler

from planspace.demos.episode import Episode
from planspace.errors import PlanspaceError, UsageError
from planspace.plan.config import PlanConfig
from planspace.plan.pipeline import Pipeline
from planspace.plan.planner import PAGE, Failure, FunctionPlanner
from planspace.seams import name_of
from planspace.tasks.problem import Problem
from planspace.workers import count_cores, exit_with_parent, worker_environment

ADVICE = f"Put the planner in a module of its own, or plan with workers=0. See {PAGE}."


def plan_one(problem: Problem, config: PlanConfig, seed: int, index: int) -> Episode | Failure:
    """Plan one demonstration in this process."""
    return Pipeline(problem, config).plan(seed, index)


def plan_all(
    problem: Problem, config: PlanConfig, seed: int, indices: range, workers: int | None
) -> Iterator[Episode | Failure]:
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
            yield pipeline.plan(seed, i)
        return
    packed = _pack(problem, config)
    context = multiprocessing.get_context("spawn")  # a fork would copy thread pools that no longer run
    workers = min(workers or count_cores(), len(indices))
    with (
        worker_environment(),
        ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker) as pool,
    ):
        futures = [pool.submit(_plan_packed, packed, seed, i) for i in indices]
        try:
            for future in futures:
                yield future.result()
        except BrokenProcessPool as error:
            raise PlanspaceError(
                f"a worker process ended unexpectedly while planning with {name_of(config.planner)}. A "
                "script must start its work under `if __name__ == '__main__':`; workers=0 plans without "
                "processes."
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def check_workers(problem: Problem, config: PlanConfig, workers: int | None) -> None:
    """Refuse a planner that worker processes cannot import, before anything is written.

    Raises:
        UsageError: the planner cannot be sent to another process.
    """
    if workers == 0:
        return
    _pack(problem, config)
    planner = config.planner
    code = planner.function if isinstance(planner, FunctionPlanner) else type(planner)
    at_prompt = code.__module__ == "__main__" and not hasattr(sys.modules["__main__"], "__file__")
    if at_prompt:
        raise UsageError(
            f"worker processes cannot import the planner {name_of(config.planner)}, which is defined at a "
            f"prompt or in a notebook. {ADVICE}"
        )


def _pack(problem: Problem, config: PlanConfig) -> bytes:
    """What a worker needs, as multiprocessing sends it."""
    try:
        return bytes(ForkingPickler.dumps((problem, config)))
    except Exception as error:  # of the user's object
        raise UsageError(
            f"the planner {name_of(config.planner)} cannot be sent to worker processes: "
            f"{type(error).__name__}: {error}. {ADVICE}"
        ) from error


def _plan_packed(packed: bytes, seed: int, index: int) -> Episode | Failure:
    """Plan one demonstration in a worker."""
    return _pipeline(packed).plan(seed, index)


@lru_cache(maxsize=2)
def _pipeline(packed: bytes) -> Pipeline:
    try:
        problem, config = ForkingPickler.loads(packed)
    except Exception as error:  # the user's module cannot be imported here
        raise UsageError(
            f"worker processes cannot import the planner: {type(error).__name__}: {error}. {ADVICE}"
        ) from None
    return Pipeline(problem, config)


def _start_worker() -> None:
    """Leave Ctrl-C to the parent, which stops the workers after their current plan; end with the parent."""
    exit_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
