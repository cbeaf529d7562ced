"""Compare our planner with OMPL's: same problems, starts, tolerance, cores and seconds per plan.

    python benchmarks/plan_ompl.py [--seconds S] [--starts N] [PROBLEM ...]          (extra `ompl`)

Every planner gets the same N starts, with one process per core and at most S seconds per plan. Our SST*
runs twice: as `planspace plan` uses it (it stops by itself after two polished plans), and alone, without
polish, for all of the S seconds, as OMPL's SST does. OMPL's plans are not polished. A plan counts as solved
if its controls, replayed in plain MuJoCo from the start, lead into the goal region; the goal need not be
held. OMPL propagates through Python callbacks, at about 30 microseconds per step, as for any user of its
Python bindings.
"""

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np

from planspace.plan.config import PlanConfig
from planspace.plan.pipeline import Pipeline
from planspace.plan.planner import Failure
from planspace.progress import progress
from planspace.tasks.problem_file import load_problem

PLANNERS = ("sst", "sst alone", "ompl-sst", "ompl-rrt", "ompl-kpiece1")


def attempt(name: str, planner: str, seconds: float, index: int) -> tuple[float, float, float]:
    """Wall time, duration of the plan (NaN: not solved), nearest distance of a failure."""
    problem = replace(load_problem(name), hold=False)
    if planner == "sst":
        config = PlanConfig.for_problem(problem)
    elif planner == "sst alone":
        changes = {"restarts": 1, "polish_max_iterations": 0, "sst_seconds": seconds}
        config = PlanConfig.for_problem(problem, **changes)
    else:
        changes = {"planner": planner, "polish_max_iterations": 0, "ompl_seconds": seconds}
        config = PlanConfig.for_problem(problem, **changes)
    worker = Pipeline(problem, config)
    rng = np.random.default_rng([0, index])
    start, goal = problem.draw_start(worker.simulator, rng), problem.draw_goal(worker.space, rng)
    began = time.perf_counter()
    found = worker.connect(start, goal, rng)
    spent = time.perf_counter() - began
    if isinstance(found, Failure):
        return spent, np.nan, found.nearest
    return spent, len(found.controls) * worker.model.opt.timestep, 0.0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problems", nargs="*", default=["cartpole-swingup", "reacher", "pendulum"])
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S")
    parser.add_argument("--starts", type=int, default=20, metavar="N")
    options = parser.parse_args()
    cores = os.cpu_count() or 1
    os.environ.update({"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"})
    rows = []
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        for name in options.problems:
            ours = np.empty(0)
            for planner in PLANNERS:
                starts = range(options.starts)
                calls = [pool.submit(attempt, name, planner, options.seconds, i) for i in starts]
                with progress(f"{name} {planner}", len(calls), unit="plan") as bar:
                    outcome = []
                    for call in calls:
                        outcome.append(call.result())
                        bar.update()
                spent, duration, near = np.array(outcome).T
                ours = duration if planner == PLANNERS[0] else ours
                solved = np.isfinite(duration)
                minutes = spent.sum() / 60 / cores
                cost = f"{np.median(duration[solved]):.2f}" if solved.any() else "none solved"
                same = f"{np.median(ours[solved]):.2f}" if solved.any() else ""
                missed = f"{np.median(near[~solved]):.2f}" if not solved.all() else ""
                rows.append(
                    f"| {name} | {planner} | {solved.mean():.0%} | {solved.sum() / minutes:.1f} | {cost} "
                    f"| {same} | {missed} | {np.median(spent):.1f} |"
                )
                print(rows[-1], flush=True)
    print(
        "| problem | planner | solved | solved a minute | duration s | ours on those starts "
        "| nearest of a failure | s a plan |"
    )
    print("|---|---|---|---|---|---|---|---|\n" + "\n".join(rows))


if __name__ == "__main__":
    main()
