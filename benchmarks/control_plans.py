"""From nothing to a robot that moves: how long it takes, and how many plans it needs.

    python benchmarks/control_plans.py runs/few --plans 5 10 20 60

For each number of plans, the three commands `planspace plan`, `planspace embed` and `planspace control` run
one after another in an empty folder on the swing-up, at default settings but for those shown, and are timed.
Rows are added to results/control/plans.csv. `--table` prints the table of docs/appendix/control.md.
"""

import json
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

from csv_rows import add_missing, make_parser, parse

RESULTS = Path(__file__).parents[1] / "results" / "control" / "plans.csv"
COLUMNS = ("plans", "embedding_seed", "plan_s", "embed_s", "control_s", "total_s", "success", "return_mean")
PROBLEM, STARTS, SAMPLES, STEPS = "cartpole-swingup", 20, 128, 3000


def main() -> None:
    """Run the rows that the results do not have yet."""
    parser = make_parser(__doc__, "an empty folder, or one of an earlier run")
    parser.add_argument("--plans", nargs="+", type=int, default=[5, 10, 20, 60], metavar="N")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="embedding seeds, one row each")
    options, rows = parse(parser, RESULTS, table)
    for plans in options.plans:
        for seed in range(options.seeds):
            key = {"plans": str(plans), "embedding_seed": str(seed)}
            folder = options.folder / f"{plans}-{seed}"
            add_missing(RESULTS, COLUMNS, rows, key, partial(measure, folder, plans, seed))


def measure(folder: Path, plans: int, seed: int) -> dict[str, str]:
    """Run the three commands with one seed."""
    made = {name: str(folder / name) for name in ("plans", "embedding", "control")}
    whole = ("--seed", str(seed))
    plan = run("plan", PROBLEM, "--num", str(plans), *whole, "--out", made["plans"])[0]
    embed = run(
        *("embed", made["plans"], "--seeds", "1", "--steps", str(STEPS), *whole, "--out", made["embedding"])
    )[0]
    control, printed = run(
        *("control", PROBLEM, "--embedding", made["embedding"], "--out", made["control"], "--no-film"),
        *("--episodes", str(STARTS), "--samples", str(SAMPLES), "--json"),
    )
    found = json.loads(printed)
    seconds = {"plan_s": plan, "embed_s": embed, "control_s": control, "total_s": plan + embed + control}
    return {
        **{name: f"{value:.0f}" for name, value in seconds.items()},
        "success": f"{found['success']:.2f}",
        "return_mean": f"{found['return_mean']:.1f}",
    }


def run(*arguments: str) -> tuple[float, str]:
    """Run a command of planspace; return its wall time [s] and what it printed."""
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "planspace", *arguments], check=True, stdout=subprocess.PIPE, text=True
    )
    return time.perf_counter() - began, done.stdout


def table(rows: list[dict[str, str]]) -> str:
    """The results as a Markdown table."""
    lines = [f"| {' | '.join(column.replace('_', ' ') for column in COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row[column] for column in COLUMNS)} |" for row in rows)])


if __name__ == "__main__":
    main()
