"""Measure how much `import planspace` adds to importing Gymnasium and MuJoCo.

    python benchmarks/import_time.py [--rounds 10]

Each round runs one process per row. The table shows the median time, and the median, minimum and maximum of
the difference from the first row of the same round.
"""

import argparse
import subprocess
import sys
import time

import numpy as np

BARE = "import gymnasium, mujoco"
IMPORTS = {
    "gymnasium and mujoco": BARE,
    "and planspace": f"{BARE}, planspace",
    "and its wrappers": f"{BARE}, planspace, planspace.envs.wrappers",
    "and a task": f"{BARE}, planspace; gymnasium.make('planspace/CartPoleSwingUp-v0')",
}


def timed(code: str) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True)
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=10)
    arguments = parser.parse_args()
    print(f"command: python benchmarks/import_time.py --rounds {arguments.rounds}")
    print(f"{'seconds':<24}{'median':>8}{'more than the first':>26}")
    rows = [{name: timed(code) for name, code in IMPORTS.items()} for _ in range(arguments.rounds + 1)][1:]
    for name in IMPORTS:
        values = np.array([row[name] for row in rows])
        added = values - np.array([row["gymnasium and mujoco"] for row in rows])
        spread = f"{np.median(added):.3f} ({added.min():.3f} to {added.max():.3f})"
        print(f"{name:<24}{np.median(values):>8.3f}{spread:>26}")


if __name__ == "__main__":
    main()
