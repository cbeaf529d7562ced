"""Check that the number that `planspace run` ends with comes out the same everywhere.

    python benchmarks/first_number.py runs/first-number

For each seed, it plans, trains the embedding and controls as `planspace run` does with the budget `small`, on
the swing-up: success by distance in z minus success by standardised raw distance, 0.32 s ahead, from the same
50 starts, with its 95 % interval. A row is added to results/run/first_number.csv for each seed. Seeds and
stages that are done are kept, so the same command goes on.

`--threads` names the setting of the machine, by default the number of cores that the process may use. Under
another setting, such as `taskset -c 0`, the seeds are run again, in a folder of their own.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

from csv_rows import read_rows, write_rows

from planspace.demos.load import load_demos
from planspace.embed.fit import fit_embedding
from planspace.plan.demonstrations import plan_into
from planspace.study.budgets import BUDGETS
from planspace.study.run_control import control_stage
from planspace.tasks.catalog import find_task
from planspace.tasks.problem_file import load_problem
from planspace.workers import count_cores

RESULTS = Path(__file__).parents[1] / "results" / "run" / "first_number.csv"
TASK = "cartpole-swingup"
COLUMNS = ("seed", "threads", "starts", "z", "raw", "difference", "low", "high", "seconds")


def main() -> None:
    """Run the seeds that the results do not have yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="where plans, embeddings and episodes are kept")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="seeds 0 to N - 1")
    parser.add_argument("--threads", default=f"{count_cores()} cores", help="name of the thread setting")
    options = parser.parse_args()
    rows = read_rows(RESULTS)
    for seed in range(options.seeds):
        cell = {"seed": str(seed), "threads": options.threads}
        if any(cell.items() <= row.items() for row in rows):
            continue
        folder = options.folder / options.threads.replace(" ", "-") / f"seed-{seed}"
        rows.append(cell | measure(folder, seed))
        print(*(rows[-1][column] for column in COLUMNS), sep="  ", flush=True)
        write_rows(RESULTS, COLUMNS, rows)


def measure(folder: Path, seed: int) -> dict[str, str]:
    """Plan, embed and control as `planspace run` does."""
    started, budget, task = time.perf_counter(), BUDGETS["small"], find_task(TASK)
    plan_into(
        load_problem(task.problem), folder / "demos", num=budget.demos, seed=seed, config=budget.planner
    )
    embedding = fit_embedding(
        load_demos(folder / "demos"),
        config=budget.fit,
        out=folder / "embedding",
        num_seeds=budget.embedding_seeds,
        seed=seed,
    )
    found = control_stage(task, embedding, folder, replace(budget.control, horizons=()), seed).reached
    assert found is not None
    low, high = found.interval
    return {
        "starts": str(found.starts),
        "z": str(found.z),
        "raw": str(found.raw),
        "difference": f"{found.difference:.3f}",
        "low": f"{low:.3f}",
        "high": f"{high:.3f}",
        "seconds": f"{time.perf_counter() - started:.0f}",
    }


if __name__ == "__main__":
    main()
