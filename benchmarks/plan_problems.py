"""Success rate, time and quality of planning, for every shipped problem.

    python benchmarks/plan_problems.py [--num N] [PROBLEM ...]

Plans N demonstrations (20 by default) of each problem as `planspace plan` does, on all cores, and then
reads the dataset: the fraction of plans found at the first attempt and in all, the largest distance to the
goal at the end (weighted L1, angles on the circle), the largest replay error in plain MuJoCo, and the time.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from planspace.demos.describe import replay_errors
from planspace.demos.load import load_demos
from planspace.errors import PartialResult
from planspace.plan.demonstrations import plan_into
from planspace.tasks.problem_file import load_problem, shipped_problems


def row(name: str, num: int, seed: int) -> str:
    problem = load_problem(name)
    with tempfile.TemporaryDirectory() as folder:
        began, partial = time.perf_counter(), ""
        try:
            plan_into(problem, Path(folder) / "demos", num=num, seed=seed)
        except PartialResult as error:
            partial = str(error)
            print(partial)
        minutes = (time.perf_counter() - began) / 60
        demos = load_demos(Path(folder) / "demos")
        _, space = demos.info.compile()
        ends, durations = demos.offsets[1:] - 1, demos.times[demos.offsets[1:] - 1]
        weights = problem.draw_goal(space, np.random.default_rng(0)).weights
        distance = space.distance(demos.states[ends], demos.goals, weights).max()
        return (
            f"| {name} | {len(demos)} of {num} | {(demos.seeds == 0).sum() / num:.1%} | {distance:.4f} "
            f"| {replay_errors(demos).max():.1g} | {np.median(durations):.2f} | {durations.max():.2f} "
            f"| {60 * minutes / num:.2f} | {minutes:.1f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problems", nargs="*", default=shipped_problems(), metavar="PROBLEM")
    parser.add_argument("--num", type=int, default=20, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rows = [row(name, options.num, options.seed) for name in options.problems]
    print(
        "| problem | solved | at once | L1 at end, most | replay error | duration s, median | most "
        "| s a plan | minutes |\n|---|---|---|---|---|---|---|---|---|"
    )
    print("\n".join(rows))


if __name__ == "__main__":
    main()
