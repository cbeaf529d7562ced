"""Policies that only imitate plans, without and with steps beside the plans (`--plan-noise`).

    OPENBLAS_NUM_THREADS=1 python benchmarks/cloning.py runs/cloning
    python benchmarks/cloning.py --table

Plans are the ready-made ones. A policy of 64 x 64 takes 20,000 gradient steps of cloning, and then one
iteration of TRPO (4000 steps, `modern`, noise 0.1), because training has at least one. The return is that of
its evaluation, in which every action is the mean of the policy, over all environments of each of five seeds.

Runs are kept in the folder. Rows are added to results/rl/cloning.csv, one for each task, noise and seed.
"""

from pathlib import Path

import numpy as np
from csv_rows import Row, add_row, has_row, make_parser, parse

from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.rl.training import train_policies
from planspace.seams import with_settings
from planspace.tasks.catalog import find_task

RESULTS = Path(__file__).parents[1] / "results" / "rl" / "cloning.csv"
TASKS = ("cartpole-swingup", "pendulum-swingup", "quadrotor-planar", "ball-pendulum")
NOISES = (0.0, 0.02, 0.05, 0.1, 0.2)
NUM_SEEDS = 5
COLUMNS = ("task", "plan_noise", "seed", "return_mean")


def main() -> None:
    """Run the cells that the results do not have yet."""
    parser = make_parser(__doc__, "where the runs are kept")
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), choices=TASKS)
    options, rows = parse(parser, RESULTS, table)
    for task in options.tasks:
        for noise in NOISES:
            key = {"task": task, "plan_noise": f"{noise:g}"}
            if has_row(rows, key):
                continue
            for seed, found in enumerate(returns_of(task, noise, options.folder)):
                add_row(RESULTS, COLUMNS, rows, key | {"seed": str(seed), "return_mean": f"{found:.1f}"})


def returns_of(task: str, noise: float, folder: Path) -> list[float]:
    """The return of each seed."""
    algorithm = with_settings(
        find_algorithm("trpo", "modern"), hidden=(64, 64), critic_hidden=(64, 64), initial_std=0.1
    )
    config = TrainConfig(
        algorithm,
        obs="trig" if find_task(task).sin_cos_columns else "raw",
        num_seeds=NUM_SEEDS,
        steps=4000,
        clone=20_000,
        plan_noise=noise,
    )
    out = folder / f"{task}-{noise:g}"
    return train_policies(task, config, plans=task, out=out).history["eval_return"][-1].tolist()


def table(rows: list[Row]) -> str:
    """Mean, worst and best return of each cell."""
    lines = [f"| task | {' | '.join(f'{noise:g}' for noise in NOISES)} |", "|---" * (len(NOISES) + 1) + "|"]
    for task in dict.fromkeys(row["task"] for row in rows):
        cells = []
        for noise in NOISES:
            key = (task, f"{noise:g}")
            found = np.array(
                [float(row["return_mean"]) for row in rows if (row["task"], row["plan_noise"]) == key]
            )
            cells.append(f"{found.mean():.0f} ({found.min():.0f}, {found.max():.0f})" if len(found) else "")
        lines.append(f"| {task} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
