"""Returns of TRPO and PPO, 15 seeds per arm (0 to 14, all reported), next to the check figures.

    OPENBLAS_NUM_THREADS=1 python benchmarks/rl_levels.py [ARM ...] [--out DIR]

Each arm is one `planspace train`. Its returns are stored in results/rl/levels.csv, and arms that it contains
are not run again. Prints the tables and draws results/rl/TASK-PRESET.png in the style of the paper. Without
arguments it runs all arms, in an hour on two cores.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from planspace.cli import main as planspace
from planspace.errors import PartialResult
from planspace.figures.learning_curves import plot_curves
from planspace.figures.style import save_figure
from planspace.rl.history import load_history
from planspace.rl.learning_curve import SMOOTHING, Curve, learning_curve, smoothed
from planspace.storage.files import make_folder
from planspace.study.tidy import Row, read_rows, write_rows

RESULTS = Path(__file__).parent.parent / "results" / "rl"
NUM_SEEDS = 15
STUDY, FILE = "levels", RESULTS / "levels.csv"
POINTS = 12
"""Approximate number of stored points of a learning curve; each is a mean of ten iterations."""
EVERY = {"algo": "trpo", "preset": "paper", "seeds": NUM_SEEDS}
SWING_UP = {"task": "cartpole-swingup", "obs": "trig", "steps": 960_000}
BALANCE = {"task": "cartpole", "obs": "raw", "steps": 400_000}
REACHER = {"task": "reacher-trig", "obs": "raw", "steps": 1_440_000}
MODERN = {"preset": "modern"}
PPO = {"algo": "ppo"}
ARMS = {
    "swingup-raw-trpo": SWING_UP | {"obs": "raw"},
    "swingup-trig-trpo": SWING_UP,
    "swingup-trig-ppo": SWING_UP | PPO,
    "cartpole-raw-trpo": BALANCE,
    "cartpole-raw-ppo": BALANCE | PPO,
    "reacher-trig-trpo": REACHER,
    "reacher-raw-trpo": REACHER | {"task": "reacher-raw", "steps": 1_200_000},
    "reacher-trig-trpo-long": REACHER | {"steps": 8_000_000},
    "swingup-trig-trpo-modern": SWING_UP | MODERN,
    "swingup-trig-ppo-modern": SWING_UP | PPO | MODERN,
    "cartpole-raw-trpo-modern": BALANCE | MODERN,
    "cartpole-raw-ppo-modern": BALANCE | PPO | MODERN,
    "reacher-trig-trpo-modern": REACHER | MODERN,
    "reacher-trig-ppo-modern": REACHER | PPO | MODERN,
}
CHECKS = {
    "swingup-raw-trpo": (-234.0, -338.0, 87.0, 32.0),
    "swingup-trig-trpo": (-126.0, -292.0, 99.0, 32.0),
    "reacher-trig-trpo": (-10.6, -14.2, -7.9, None),
    "reacher-raw-trpo": (-12.7, -15.6, -10.2, None),
}
"""Results of an independent quick study with nearly this preset: mean of the last iteration, worst, best, and
standard error of the mean (25 to 39 on the swing-up; None uses our own)."""


def command(name: str) -> list[str]:
    settings = EVERY | ARMS[name]
    task = settings.pop("task")
    return [
        "train",
        str(task),
        *(word for key, value in settings.items() for word in (f"--{key}", str(value))),
    ]


def run_arm(name: str, runs: Path) -> list[Row]:
    """Train an arm and return its returns as rows of the table."""
    words, out = command(name), runs / name
    if (code := planspace([*words, "--out", str(out)])) not in (0, PartialResult.exit_code):
        sys.exit(code)
    history = load_history(out)
    returns, steps = history["return"], history["steps"]
    end = int(steps[-1])
    rows = []
    for seed, of_seed in enumerate(returns.T):
        rows.append(Row(STUDY, name, seed, None, end, "last_return", of_seed[-1]))
        evaluation = history["eval_return"][-1, seed]
        rows.append(Row(STUDY, name, seed, None, end, "evaluation_return", evaluation))
        if len(reached := np.flatnonzero(of_seed >= 100)):
            rows.append(Row(STUDY, name, seed, None, None, "steps_to_100", steps[reached[0]]))
    skipped, diverged = history["skipped"].sum(), history["frozen"][-1].sum()
    rows.append(Row(STUDY, name, None, None, None, "skipped_updates", skipped))
    rows.append(Row(STUDY, name, None, None, None, "diverged", diverged))
    curve, every = smoothed(returns), SMOOTHING * max(1, len(returns) // SMOOTHING // POINTS)
    for i in range(every - 1, len(returns), every):
        for seed, value in enumerate(curve[i]):
            rows.append(Row(STUDY, name, seed, None, int(steps[i]), "return", round(float(value), 2)))
    return rows


def metric(rows: list[Row], name: str, metric: str) -> np.ndarray:
    """A number of each seed of an arm."""
    return np.array([row.value for row in rows if (row.arm, row.metric) == (name, metric)])


def table(names: list[str], rows: list[Row]) -> None:
    print(f"{'':<28}{'mean':>9}{'error':>8}{'worst':>9}{'best':>9}{'evaluation':>12}{'diverged':>10}   check")
    for name in names:
        last, evaluation = metric(rows, name, "last_return"), metric(rows, name, "evaluation_return")
        error = last.std(ddof=1) / np.sqrt(len(last))
        row = f"{name:<28}{last.mean():>9.1f}{error:>8.1f}{last.min():>9.1f}{last.max():>9.1f}"
        row += f"{evaluation.mean():>12.1f}{metric(rows, name, 'diverged')[0]:>10.0f}"
        if name in CHECKS:
            mean, worst, best, their_error = CHECKS[name]
            margin = 1.96 * np.hypot(error, error if their_error is None else their_error)
            difference = last.mean() - mean
            row += f"   {mean} ({worst}, {best}); difference {difference:.1f} +- {margin:.1f}: "
            row += "passes" if difference + margin >= 0 else "FAILS"
        print(row)


def draw(names: list[str], rows: list[Row]) -> None:
    """Draw a figure for each task and preset; the long run has its own."""
    figures: dict[str, dict[str, Curve]] = {}
    for name in names:
        arm = EVERY | ARMS[name]
        points = [row for row in rows if row.arm == name and row.metric == "return"]
        steps = np.array(sorted({row.step for row in points}))
        returns = np.array([[row.value for row in points if row.step == step] for step in steps])
        ending = "-long" if name.endswith("-long") else ""
        figure = figures.setdefault(f"{arm['task']}-{arm['preset']}{ending}", {})
        label = f"{arm['obs']}, {str(arm['algo']).upper()}"
        figure[label] = learning_curve({"return": returns, "steps": steps}, window=1)
    for title, curves in figures.items():
        print(save_figure(plot_curves(curves, title), RESULTS, title))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("arms", nargs="*", metavar="ARM", help=", ".join(ARMS))
    parser.add_argument("--out", type=Path, default=Path("runs/rl-levels"), help="folder of the runs")
    options = parser.parse_args()
    names = options.arms or list(ARMS)
    rows = read_rows(FILE) if FILE.exists() else []
    for name in names:
        if not len(metric(rows, name, "last_return")):
            rows += run_arm(name, options.out)
            write_rows(rows, make_folder(RESULTS) / FILE.name)
    print("command: python benchmarks/rl_levels.py", *options.arms)
    for preset in ("paper", "modern"):  # never in one table
        if chosen := [name for name in names if (EVERY | ARMS[name])["preset"] == preset]:
            print(f"\n{preset}")
            table(chosen, rows)
    draw(names, rows)


if __name__ == "__main__":
    main()
