"""Durations of plans, relative to the shortest, on problems whose shortest duration is known.

    python benchmarks/ground_truth.py
    python benchmarks/plan_quality.py [--num N] [--restarts N] [--no-polish]

Plans N demonstrations (60 by default) as `planspace plan` does and divides each duration by the one from
`ground_truth.py`. For the reacher that is the time to rest exactly at the goal; a demonstration ends as
soon as it is within the tolerance of 0.1, so its ratio can be below 1. The pendulum's ratio can be below 1
by the error of its grid (0.5 % from one resolution to the next).
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from ground_truth import FOLDER, pendulum_time, reacher_time

from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.tasks.problem_file import load_problem


def shortest(name: str, demos: Demos) -> np.ndarray:
    """Shortest known duration from each demonstration's start."""
    starts = demos.states[demos.offsets[:-1]]
    if name == "pendulum":
        return pendulum_time(starts)
    if name.startswith("reacher"):
        return np.array([reacher_time(a, b) for a, b in zip(starts, demos.goals, strict=True)])
    with np.load(FOLDER / "cartpole-swingup.npz") as known:
        np.testing.assert_allclose(np.sin(known["starts"][: len(starts)]), np.sin(starts), atol=1e-9)
        return known["duration"][: len(starts)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--num", type=int, default=60, metavar="N")
    parser.add_argument("--restarts", type=int, default=None, metavar="N")
    parser.add_argument("--no-polish", action="store_true")
    options = parser.parse_args()
    rows = []
    for name in ("pendulum", "reacher", "reacher-random", "cartpole-swingup"):
        problem = load_problem(name)
        config = PlanConfig.for_problem(
            problem, restarts=options.restarts, polish_max_iterations=0 if options.no_polish else None
        )
        with tempfile.TemporaryDirectory() as folder:
            plan_into(problem, Path(folder) / "demos", num=options.num, seed=0, config=config)
            demos = load_demos(Path(folder) / "demos")
        ratio = demos.times[demos.offsets[1:] - 1] / shortest(name, demos)
        low, median, high, most = np.quantile(ratio, [0.1, 0.5, 0.9, 1.0])
        share = (ratio <= 1.1).mean()
        rows.append(
            f"| {name} | {len(demos)} | {median:.3f} | {low:.3f} to {high:.3f} | {most:.2f} | {share:.0%} |"
        )
    print("| problem | plans | duration / shortest, median | 80 % lie in | maximum | within 10 % |")
    print("|---|---|---|---|---|---|\n" + "\n".join(rows))


if __name__ == "__main__":
    main()
