"""Write the bands that `planspace run --train` draws its learning curves over.

    python benchmarks/run_bands.py

For each arm of `planspace run`, the mean and the second worst and second best of the 15 seeds in
results/study/controls-half, at every 100,000 steps. The file is shipped with the package.
"""

import argparse
from pathlib import Path

import numpy as np
from csv_rows import read_rows, write_rows

from planspace.rl.learning_curve import learning_curve
from planspace.study.budgets import BUDGETS
from planspace.study.run_policies import BANDS, run_arms
from planspace.tasks.catalog import find_task

RESULTS = Path(__file__).parents[1] / "results" / "study" / "controls-half" / "results.csv"
TASK = "cartpole-swingup"
COLUMNS = ("arm", "steps", "mean", "low", "high")


def band_rows(task: str = TASK) -> list[dict[str, str]]:
    """The rows of a task's file."""
    found = [row for row in read_rows(RESULTS) if row["metric"] == "return"]
    rows = []
    for label, _, _ in run_arms(find_task(task), BUDGETS["small"], 0):
        arm = [row for row in found if row["arm"] == f"{task}, TRPO/{label}"]
        steps = sorted({int(row["step"]) for row in arm})
        table = [[float(row["value"]) for row in arm if int(row["step"]) == step] for step in steps]
        curve = learning_curve({"steps": np.array(steps), "return": np.array(table)}, window=1)
        for step, *numbers in zip(steps, curve.mean, curve.low, curve.high, strict=True):
            rows.append(dict(zip(COLUMNS, (label, str(step), *(f"{x:.1f}" for x in numbers)), strict=True)))
    return rows


def main() -> None:
    """Write the file."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    BANDS.mkdir(exist_ok=True)
    write_rows(BANDS / f"{TASK}.csv", COLUMNS, band_rows())


if __name__ == "__main__":
    main()
