"""Durations and times of plans, compared with those that dynobench has of iDb-A* and of RRT + optimisation.

    git clone https://github.com/quimortiz/dynobench        (MIT licence)
    python benchmarks/dynobench_problems.py FOLDER [--only NAME] [--seeds N] [--seconds S] [--defaults]

FOLDER holds SYSTEM.model.yaml, SYSTEM.PROBLEM.yaml and solutions.csv (system, problem, planner, time_ms,
cost_s: the time of a planner's last improvement and the duration of its plan). See `dynobench.py` for the
models.

The planner has no mode that keeps improving a plan. As `planspace plan --restarts N` does, searches are
repeated, each with its polish, and the shortest plan is kept; here until the process has used S seconds of
CPU. Each search has a seed of its own. Every improvement is recorded with its wall and CPU seconds, counted
from before the model is compiled. One thread; timings made while other programs run are upper bounds.

Each problem and seed is a row of results/planning/dynobench.csv. A row that the file has is not measured
again. `--defaults` plans with the default settings of `planspace plan` instead of SETTINGS below. `--table`
prints the tables of docs/appendix/planning.md, one for each settings.
"""

import argparse
import csv
import platform
import time
import warnings
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from csv_rows import Row, read_rows, write_rows
from dynobench import load_dynobench, problem_names

from planspace.plan.config import PlanConfig
from planspace.plan.pipeline import Pipeline
from planspace.plan.trajectory import Trajectory
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem

RESULTS = Path(__file__).parents[1] / "results" / "planning" / "dynobench.csv"
COLUMNS = (
    "problem",
    "seed",
    "settings",
    "cpu",
    "searches",
    "cpu_s",
    "improvements",
    "idbastar_s",
    "idbastar_duration_s",
    "rrt_to_duration_s",
)
"""`improvements` is a list of duration@wall/cpu, all in seconds; the rest of the row is plain."""
COMMON = {"polish_repairs": 60, "polish_velocity_margin": 0.01}
SETTINGS: dict[str, dict[str, Any]] = {
    "acrobot_v0": COMMON,
    "quad2d_v0": COMMON | {"max_rounds": 24},
    "quad2dpole_v0": COMMON | {"max_rounds": 24},
}
"""Settings of each system that differ from the defaults."""
NUM_SEEDS = 3
SECONDS = 30.0


def main() -> None:
    """Plan for the problems and seeds that the results do not have yet."""
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", help="folder with the files of dynobench")
    parser.add_argument("--table", action="store_true", help="print the table and do nothing else")
    parser.add_argument("--only", default="", help="plan only for problems whose name contains this")
    parser.add_argument("--seeds", type=int, default=NUM_SEEDS, help="number of seeds per problem")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="CPU seconds per problem and seed")
    parser.add_argument("--defaults", action="store_true", help="plan with default settings")
    parser.add_argument("--out", type=Path, default=RESULTS, help="CSV file of the results")
    options = parser.parse_args()
    rows = read_rows(options.out)
    if options.table:
        for own in (False, True):
            print("\n".join(table([row for row in rows if bool(row["settings"]) == own])), end="\n\n")
        return
    if options.folder is None:
        parser.error("give the folder with the files of dynobench")
    for seed in range(options.seeds):
        for name in problem_names(options.folder):
            settings = {} if options.defaults else SETTINGS[name.partition(".")[0]]
            done = {order(row) for row in rows}
            if options.only in name and (bool(settings), name, seed) not in done:
                rows.append(measure(options.folder, name, seed, options.seconds, settings))
                print(*rows[-1].values(), sep="  ", flush=True)
                write_rows(options.out, COLUMNS, sorted(rows, key=order))


def order(row: Row) -> tuple[bool, str, int]:
    """The order of the rows: those at default settings first."""
    return bool(row["settings"]), row["problem"], int(row["seed"])


def measure(folder: Path, name: str, seed: int, seconds: float, settings: dict[str, Any]) -> dict[str, str]:
    """Search until the CPU time is over, and list the improvements."""
    problem = load_problem(load_dynobench(folder, name))
    searches, cpu_s, improvements = search(problem, settings, seed, seconds)
    known = published(folder)[name]
    return {
        "problem": name,
        "seed": str(seed),
        "settings": "; ".join(f"{key}: {value}" for key, value in settings.items()),
        "cpu": cpu_name(),
        "searches": str(searches),
        "cpu_s": f"{cpu_s:.1f}",
        "improvements": " ".join(f"{d:.2f}@{wall:.2f}/{cpu:.2f}" for d, wall, cpu in improvements),
        "idbastar_s": f"{float(known['idbastar']['time_ms']) / 1000:.2f}",
        "idbastar_duration_s": f"{float(known['idbastar']['cost_s']):.2f}",
        "rrt_to_duration_s": f"{float(known['rrt_to']['cost_s']):.2f}" if "rrt_to" in known else "",
    }


def search(
    problem: Problem, settings: dict[str, Any], seed: int, seconds: float
) -> tuple[int, float, list[tuple[float, float, float]]]:
    """Repeat search and polish for some CPU seconds.

    Returns:
        The number of searches; the CPU seconds used; and of each improvement its duration, and the wall and
        CPU seconds after which it was known [s].
    """
    wall, cpu, count = time.perf_counter(), time.process_time(), 0
    improvements: list[tuple[float, float, float]] = []
    pipeline = Pipeline(problem, PlanConfig.for_problem(problem, restarts=1, **settings))
    while count == 0 or time.process_time() - cpu < seconds:
        rng = np.random.default_rng(np.random.SeedSequence([seed, count]))
        start = problem.draw_start(pipeline.simulator, rng)
        goal = problem.draw_goal(pipeline.space, rng, pipeline.simulator)
        found, count = pipeline.connect(start, goal, rng), count + 1
        if isinstance(found, Trajectory):
            duration = len(found.controls) * pipeline.model.opt.timestep
            if not improvements or duration < improvements[-1][0] - 1e-9:
                taken = time.perf_counter() - wall, time.process_time() - cpu
                improvements.append((duration, *taken))
    return count, time.process_time() - cpu, improvements


def published(folder: Path) -> dict[str, dict[str, dict[str, str]]]:
    """The rows of solutions.csv, by SYSTEM.PROBLEM and planner."""
    found: dict[str, dict[str, dict[str, str]]] = defaultdict(dict)
    with (folder / "solutions.csv").open() as file:
        for row in csv.DictReader(file):
            found[f"{row['system']}.{row['problem']}"][row["planner"]] = row
    return found


def cpu_name() -> str:
    """The name of this machine's CPU."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def improvements_of(row: dict[str, str]) -> list[tuple[float, float, float]]:
    """Duration, wall seconds and CPU seconds of each improvement."""
    parts = (text.replace("@", "/").split("/") for text in row["improvements"].split())
    return [(float(duration), float(wall), float(cpu)) for duration, wall, cpu in parts]


class Summary:
    """What the seeds of one problem found; infinite where a seed found nothing."""

    def __init__(self, rows: list[dict[str, str]]):
        """Read the rows of one problem."""
        runs = [improvements_of(row) for row in rows]
        self.num, self.solved = len(runs), sum(bool(run) for run in runs)
        self.published, self.published_s = (
            float(rows[0][key]) for key in ("idbastar_duration_s", "idbastar_s")
        )
        self.rrt = rows[0]["rrt_to_duration_s"]
        self.durations = [run[-1][0] if run else np.inf for run in runs]
        self.first_s = float(np.median([run[0][2] if run else np.inf for run in runs]))
        beaten = [[cpu for duration, _, cpu in run if duration <= self.published] for run in runs]
        self.beaten = sum(bool(times) for times in beaten)
        self.beaten_s = float(np.median([times[0] if times else np.inf for times in beaten]))

    @property
    def shorter(self) -> bool:
        """Whether the median duration is shorter than that of iDb-A*."""
        return float(np.median(self.durations)) < self.published

    @property
    def faster(self) -> bool:
        """Whether a duration no longer than that of iDb-A* took no longer than its recorded time."""
        return self.beaten_s <= self.published_s

    def cells(self, name: str) -> list[str]:
        """The row of the table."""
        median = float(np.median(self.durations))
        return [
            name,
            f"{self.solved} of {self.num}",
            *(_text(x) for x in (min(self.durations), median, self.published)),
            self.rrt,
            *(_text(x) for x in (self.first_s, self.beaten_s, self.published_s)),
        ]


def summaries(rows: list[dict[str, str]]) -> dict[str, Summary]:
    """The summary of each problem, in the order of their names."""
    of: dict[str, list[dict[str, str]]] = defaultdict(list)
    for row in rows:
        of[row["problem"]].append(row)
    return {name: Summary(of[name]) for name in sorted(of)}


def table(rows: list[dict[str, str]]) -> list[str]:
    """The results as lines of Markdown."""
    lines = [
        "| problem | solved | best [s] | median [s] | iDb-A* [s] | RRT + opt. [s] | CPU s to a plan "
        "| CPU s to iDb-A*'s duration | time of iDb-A* [s] |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    found = summaries(rows)
    lines += [f"| {' | '.join(each.cells(name))} |" for name, each in found.items()]
    return lines


def _text(number: float) -> str:
    return f"{number:.2f}" if np.isfinite(number) else "-"


if __name__ == "__main__":
    main()
