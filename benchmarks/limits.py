"""Measure peak memory and time of commands on large datasets.

    python benchmarks/limits.py [--out DIR]

Datasets of 10,000 to 1,000,000 steps are imported, validated, described and sampled. Each stage runs in a
separate process, whose peak memory is read from /proc. `demos show` is also timed three times on a dataset
of 100,000 demonstrations.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

STEPS = (10_000, 100_000, 1_000_000)
LENGTH = 100
MEASURE = "print('peak', next(x.split()[1] for x in open('/proc/self/status') if x.startswith('VmHWM')))"
"""Prints the peak memory; ru_maxrss would include the memory of the parent process."""
IMPORT = "from planspace.cli import main; assert not main(['demos', 'import', '{npz}', '--out', '{demos}'])"
VALIDATE = "from planspace.cli import main; assert main(['demos', 'validate', '{demos}']) == 0"
SHOW = "from planspace.cli import main; assert main(['demos', 'show', '{demos}']) == 0"
TRIPLETS = """
from pathlib import Path
import numpy as np
from planspace.demos.stored import StoredDemos
from planspace.demos.triplets import random_triplets
demos, rng = StoredDemos(Path('{demos}')), np.random.default_rng(0)
for _ in range(10):
    demos.states_at(random_triplets(demos, np.arange(len(demos)), 10_000, rng))
"""
LISTED, LISTED_LENGTH = 100_000, 40
"""Number of demonstrations for `demos show`, and their steps; a planned swing-up has about as many steps."""


def make_archive(path: Path, steps: int, length: int = LENGTH) -> None:
    """Write an NPZ archive of random demonstrations.

    Args:
        path: the file.
        steps: total number of steps.
        length: steps per demonstration.
    """
    rng = np.random.default_rng(0)
    num = steps // length
    rows = num * (length + 1)
    np.savez(
        path,
        states=rng.normal(size=(rows, 4)),
        controls=rng.normal(size=(rows, 1)),
        time=np.tile(0.02 * np.arange(length + 1), num),
        offsets=np.arange(num + 1) * (length + 1),
    )


def peak_mb(code: str) -> tuple[float, float]:
    """Run code in a new process and return its peak memory [MB] and wall time [s]."""
    began = time.monotonic()
    words = [sys.executable, "-c", f"{code}\n{MEASURE}"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(done.stderr[-2000:])
    return int(done.stdout.split()[-1]) / 1024, time.monotonic() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/limits"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    print("command: python benchmarks/limits.py", " ".join(sys.argv[1:]))
    print("| steps | stage | peak [MB] | time [s] |\n|---|---|---|---|")
    for steps in STEPS:
        names = {"npz": str(options.out / f"{steps}.npz"), "demos": str(options.out / f"demos-{steps}")}
        make_archive(Path(names["npz"]), steps)
        for stage, code in (
            ("import", IMPORT),
            ("validate", VALIDATE),
            ("show", SHOW),
            ("triplets", TRIPLETS),
        ):
            peak, seconds = peak_mb(code.format(**names))
            print(f"| {steps:,} | {stage} | {peak:.0f} | {seconds:.1f} |", flush=True)
    names = {"npz": str(options.out / "listed.npz"), "demos": str(options.out / "listed")}
    make_archive(Path(names["npz"]), LISTED * LISTED_LENGTH, LISTED_LENGTH)
    peak_mb(IMPORT.format(**names))
    for _ in range(3):
        peak, seconds = peak_mb(SHOW.format(**names))
        print(f"| {LISTED * LISTED_LENGTH:,} in {LISTED:,} | show | {peak:.0f} | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main()
