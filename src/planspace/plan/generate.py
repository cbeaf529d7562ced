"""Many plans: seeded starts, worker processes, shards committed as they are made, resume."""

import json
import multiprocessing
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

import numpy as np

from planspace.demos.dataset import Episode, StateInfo
from planspace.demos.folder import DemoFolder
from planspace.errors import PartialResult, UsageError
from planspace.physics.simulator import Simulator
from planspace.plan.ompl import check_ompl
from planspace.plan.planner import MAX_ATTEMPTS, Failure, Planner, PlannerConfig
from planspace.progress import progress
from planspace.storage.checks import reject_malformed
from planspace.storage.files import read_bytes
from planspace.storage.provenance import Provenance
from planspace.storage.rows import append_rows
from planspace.tasks.problem import Problem
from planspace.workers import count_cores, end_with_parent, worker_environment

SHARD_EPISODES = 10
"""Plans a shard. A kill costs those since the last one; Ctrl-C and errors cost only plans under way."""
LOG = "log.jsonl"


def generate(
    problem: Problem,
    out: Path,
    *,
    num: int,
    seed: int,
    config: PlannerConfig | None = None,
    workers: int | None = None,
) -> DemoFolder:
    """Plans demonstrations from random starts and stores them.

    The plans already in the folder are kept; plan i depends on the problem, the settings, the seed and i
    alone, so an interrupted command ends with the same content as one that was not.

    Args:
        problem: what to plan.
        out: the dataset folder.
        num: how many plans it is to hold.
        seed: the seed of all of them.
        config: planner settings; by default the problem's own.
        workers: processes; by default one for each CPU. 0 plans in this one, where linear algebra may take
            several threads and other kernels, and round otherwise.

    Returns:
        The folder.

    Raises:
        PlanspaceError: the folder cannot be written or holds something else, or the problem has no start.
        PartialResult: some plans failed at every attempt; the others are saved.
    """
    config = config or PlannerConfig.for_problem(problem)
    _check_predicate(problem)
    _check_start(problem)
    if config.planner != "sst":
        check_ompl(config.planner, problem)
    folder = DemoFolder(
        out,
        state_info(problem),
        {
            "problem": problem.hash,
            "seed": seed,
            "planner": config.planner,
            "config": asdict(config),
            "versions": Provenance.current("mujoco").plain(),
        },
    )
    remaining = range(folder.next_index, num)
    if remaining:
        _extend(folder, problem, config, seed, remaining, workers)
    _report_missing(folder)
    return folder


def _extend(
    folder: DemoFolder,
    problem: Problem,
    config: PlannerConfig,
    seed: int,
    remaining: range,
    workers: int | None,
) -> None:
    """Plans what is missing; whatever stops it, the plans that are done are saved."""
    batch, failures, solved, next_index = [], [], 0, remaining.start

    def save() -> None:
        row = {"time": time.time(), "planned": next_index, "failures": list(failures)}
        append_rows(folder.path / LOG, [row], key="planned")  # first, so that none is missing
        folder.append(batch, next_index)
        batch.clear()
        failures.clear()

    began = time.monotonic()
    with progress("plan", remaining.stop, done=remaining.start, unit="plan") as bar:
        try:
            plans = _plan_all(problem, config, seed, remaining, workers)
            for i, plan in zip(remaining, plans, strict=True):
                if isinstance(plan, Failure):
                    nearest = plan.nearest if np.isfinite(plan.nearest) else None
                    failures.append({"plan": i, "nearest": nearest, "reason": plan.reason})
                else:
                    batch.append(plan)
                    solved += 1
                next_index = i + 1
                tried, minutes = next_index - remaining.start, (time.monotonic() - began) / 60
                bar.set_postfix_str(
                    f"{solved} of {tried} solved, {solved / minutes:.0f} a minute", refresh=False
                )
                bar.update()
                if next_index % SHARD_EPISODES == 0:
                    save()
        finally:
            if next_index > folder.next_index:
                save()


def _report_missing(folder: DemoFolder) -> None:
    missing = folder.next_index - folder.num_episodes
    if not missing:
        return
    with reject_malformed(folder.path / LOG):
        rows = (json.loads(line) for line in read_bytes(folder.path / LOG).splitlines())
        failures = [failure for row in rows for failure in row["failures"]]
        near = [failure for failure in failures if failure["nearest"] is not None]
        closest = min(near, key=lambda failure: failure["nearest"], default=None)
        where = (
            f" The nearest came within {closest['nearest']:.3g} of it ({closest['reason']})."
            if closest
            else ""
        )
    raise PartialResult(
        f"{missing} of {folder.next_index} plans found no way to the goal in {MAX_ATTEMPTS} attempts.{where} "
        f"The other {folder.num_episodes} are saved in {folder.path}."
    )


def _check_predicate(problem: Problem) -> None:
    """Worker processes must find it by its name, and the dataset is known by it."""
    name = getattr(problem.predicate, "__qualname__", "<none>")
    if problem.predicate is not None and ("<" in name or not hasattr(problem.predicate, "__module__")):
        raise UsageError("the predicate must be a function that its module has by name, not a lambda.")


def _check_start(problem: Problem) -> None:
    """A problem without a valid start is refused before anything is written."""
    model, space = problem.compile()
    simulator = Simulator(model, space, 1, threads=1, validity=problem.validity)
    problem.draw_start(simulator, np.random.default_rng(0))


def state_info(problem: Problem) -> StateInfo:
    """What the states of a problem's demonstrations are."""
    model, space = problem.compile()
    return StateInfo.of_model(model, space, problem=problem.name, joints=problem.joints, mjcf=problem.mjcf)


def plan_one(problem: Problem, config: PlannerConfig, seed: int, index: int) -> Episode | Failure:
    """Plans one demonstration."""
    return _planner(problem, config).plan(seed, index)


@lru_cache(maxsize=2)
def _planner(problem: Problem, config: PlannerConfig) -> Planner:
    return Planner(problem, config)


def _plan_all(
    problem: Problem, config: PlannerConfig, seed: int, indices: range, workers: int | None
) -> Iterator[Episode | Failure]:
    """The plans in order, made in worker processes."""
    if workers == 0:
        for i in indices:
            yield plan_one(problem, config, seed, i)
        return
    workers = min(workers or count_cores(), len(indices))
    context = multiprocessing.get_context("spawn")  # a fork would copy thread pools that no longer run
    with (
        worker_environment(),
        ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker) as pool,
    ):
        futures = [pool.submit(plan_one, problem, config, seed, i) for i in indices]
        try:
            for future in futures:
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _start_worker() -> None:
    """Leaves Ctrl-C to the parent, which stops the workers after the plan they are at, and ends with it."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
