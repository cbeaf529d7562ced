"""The levels that TRPO and PPO reach: 15 seeds an arm, seeds 0 to 14, none dropped, beside the check figures.

    OPENBLAS_NUM_THREADS=1 python benchmarks/rl_levels.py [ARM ...] [--out DIR]

Each arm is one `planspace train`, whose command is kept with its returns in results/rl/ARM.json; an arm whose
file is there is not run again. Prints the tables and draws results/rl/TASK-PRESET.png in the
paper's manner. Without arms, all of them: an hour on two cores.
"""

import argparse
import json
import shlex
import sys
from pathlib import Path

import numpy as np

from planspace.cli import main as planspace
from planspace.errors import PartialResult
from planspace.figures.learning_curves import plot_curves
from planspace.figures.style import save_figure
from planspace.rl.config import BATCH_STEPS
from planspace.rl.history import load_history
from planspace.rl.learning_curve import SMOOTHING, Curve, learning_curve
from planspace.storage.files import write_bytes
from planspace.storage.json_files import read_json

RESULTS = Path(__file__).parent.parent / "results" / "rl"
NUM_SEEDS = 15
KEPT_ROWS = SMOOTHING
"""The returns kept are means of so many iterations, rounded to 2 decimals; no further smoothed when drawn."""
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
"""Of an independent quick study with nearly this preset: mean of the last iteration, worst, best, and the
standard error of the mean (25 to 39 on the swing-up; where it is not known, ours is taken for it)."""


def command(name: str) -> list[str]:
    settings = EVERY | ARMS[name]
    task = settings.pop("task")
    return [
        "train",
        str(task),
        *(word for key, value in settings.items() for word in (f"--{key}", str(value))),
    ]


def run_arm(name: str, runs: Path) -> None:
    words, out = command(name), runs / name
    if (code := planspace([*words, "--out", str(out)])) not in (0, PartialResult.exit_code):
        sys.exit(code)
    history, settings = load_history(out), read_json(out / "config.json")
    returns, steps = history["return"], history["steps"]
    rows = len(returns) // KEPT_ROWS * KEPT_ROWS
    kept = returns[:rows].reshape(-1, KEPT_ROWS, returns.shape[1]).mean(axis=1)
    result = {
        "command": shlex.join(["planspace", *words]),
        "versions": settings["versions"],
        "seeds": list(range(NUM_SEEDS)),
        "last": np.round(returns[-1], 2).tolist(),
        "evaluation": np.round(history["eval_return"][-1], 2).tolist(),
        "steps_to_100": [int(steps[h[0]]) if len(h := np.flatnonzero(r >= 100)) else None for r in returns.T],
        "skipped": int(history["skipped"].sum()),
        "frozen": int(history["frozen"][-1].sum()),
        "kept_every": KEPT_ROWS * BATCH_STEPS,
        "returns": np.round(kept, 2).tolist(),
    }
    write_bytes(RESULTS / f"{name}.json", (json.dumps(result) + "\n").encode())


def table(names: list[str]) -> None:
    print(f"{'':<28}{'mean':>9}{'error':>8}{'worst':>9}{'best':>9}{'evaluation':>12}{'frozen':>8}   check")
    for name in names:
        result = read_json(RESULTS / f"{name}.json")
        last = np.array(result["last"])
        error = last.std(ddof=1) / np.sqrt(len(last))
        row = f"{name:<28}{last.mean():>9.1f}{error:>8.1f}{last.min():>9.1f}{last.max():>9.1f}"
        row += f"{np.mean(result['evaluation']):>12.1f}{result['frozen']:>8}"
        if name in CHECKS:
            mean, worst, best, their_error = CHECKS[name]
            margin = 1.96 * np.hypot(error, error if their_error is None else their_error)
            difference = last.mean() - mean
            row += f"   {mean} ({worst}, {best}); difference {difference:.1f} +- {margin:.1f}: "
            row += "passes" if difference + margin >= 0 else "FAILS"
        print(row)


def draw(names: list[str]) -> None:
    """A figure for each task and preset; the long run has its own."""
    figures: dict[str, dict[str, Curve]] = {}
    for name in names:
        arm, result = EVERY | ARMS[name], read_json(RESULTS / f"{name}.json")
        returns = np.array(result["returns"])
        steps = result["kept_every"] * np.arange(1, len(returns) + 1)
        curve = learning_curve({"return": returns, "steps": steps}, window=1)
        ending = "-long" if name.endswith("-long") else ""
        figure = figures.setdefault(f"{arm['task']}-{arm['preset']}{ending}", {})
        figure[f"{arm['obs']}, {str(arm['algo']).upper()}"] = curve
    for title, curves in figures.items():
        print(save_figure(plot_curves(curves, title), RESULTS, title))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("arms", nargs="*", metavar="ARM", help=", ".join(ARMS))
    parser.add_argument("--out", type=Path, default=Path("runs/rl-levels"), help="folder of the runs")
    options = parser.parse_args()
    names = options.arms or list(ARMS)
    RESULTS.mkdir(parents=True, exist_ok=True)
    for name in names:
        if not (RESULTS / f"{name}.json").exists():
            run_arm(name, options.out)
    print("command: python benchmarks/rl_levels.py", *options.arms)
    for preset in ("paper", "modern"):  # never in one table
        if chosen := [name for name in names if (EVERY | ARMS[name])["preset"] == preset]:
            print(f"\n{preset}")
            table(chosen)
    draw(names)


if __name__ == "__main__":
    main()
