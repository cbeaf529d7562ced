"""The search with and without a metric, up to its first solution.

    python benchmarks/plan_metric.py EMBEDDINGS [PROBLEM ...]

EMBEDDINGS holds, for each problem, the embedding PROBLEM-variational-time with a time head, as
`benchmarks/control.py` makes it. Each search starts from the same starts, on one thread; nothing is polished.
Prints simulated steps and CPU seconds to the first solution, and its duration.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from planspace.embed.saved_embedding import load_embedding
from planspace.plan.config import PlanConfig
from planspace.plan.pipeline import Pipeline
from planspace.plan.sst import SST
from planspace.plan.sst_search import SearchResult, SSTSearch
from planspace.tasks.problem_file import load_problem

PROBLEMS = ("cartpole-swingup", "pendulum", "quadrotor-planar", "acrobot")


def first_solution(pipeline: Pipeline, planner: SST, seed: int) -> tuple[SearchResult, float]:
    """The first solution from one start, and the CPU seconds it took."""
    problem, rng = pipeline.problem, np.random.default_rng([seed, 0])
    start = problem.draw_start(pipeline.simulator, rng)
    goal = problem.draw_goal(pipeline.space, rng, pipeline.simulator)
    query, began = pipeline.query(start, goal), time.process_time()
    return SSTSearch(planner, query, rng).solve(), time.process_time() - began


def main() -> None:
    """Print a row for each problem and metric."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("embeddings", type=Path, metavar="EMBEDDINGS")
    parser.add_argument("problems", nargs="*", default=PROBLEMS, metavar="PROBLEM")
    parser.add_argument("--starts", type=int, default=10)
    options = parser.parse_args()
    print(
        "| problem | metric | solved | simulated steps, median (maximum) | CPU s, median (maximum) "
        "| duration [s] |\n|---|---|---|---|---|---|"
    )
    for name in options.problems:
        problem = load_problem(name)
        embedding = load_embedding(options.embeddings / f"{name}-variational-time")
        config = PlanConfig.for_problem(problem, restarts=1, min_rounds=1, tail_every=1)
        metrics = {"none": None, "distance in z": embedding.distance, "time to go": embedding.time_to_go}
        for label, metric in metrics.items():
            pipeline = Pipeline(problem, replace(config, metric=metric))
            assert isinstance(config.planner, SST)
            found = [first_solution(pipeline, config.planner, seed) for seed in range(options.starts)]
            steps = np.array([result.simulated_steps for result, _ in found])
            seconds = np.array([spent for _, spent in found])
            durations = [result.cost for result, _ in found if result.arrived]
            cells = [
                name,
                label,
                f"{len(durations)} of {len(found)}",
                f"{np.median(steps):,.0f} ({steps.max():,})",
                f"{np.median(seconds):.2f} ({seconds.max():.2f})",
                f"{np.median(durations):.2f}",
            ]
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
