"""What large datasets cost: memory while one is imported, validated and cut into triplets; time to list one.

    python benchmarks/limits.py [--out DIR]

Every stage runs in a process of its own, on ten times as many steps each time; its peak memory is what the
operating system says.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

STEPS = (10_000, 100_000, 1_000_000)
LENGTH = 100
MEASURE = "import resource; print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
IMPORT = "from planspace.cli import main; assert not main(['demos', 'import', '{npz}', '--out', '{demos}'])"
VALIDATE = "from planspace.cli import main; assert main(['demos', 'validate', '{demos}']) == 0"
SHOW = "from planspace.cli import main; assert main(['demos', 'show', '{demos}']) == 0"
TRIPLETS = """
import numpy as np
from planspace.demos.dataset import load_demos
from planspace.demos.triplets import random_triplets
demos = load_demos('{demos}')
random_triplets(demos, np.arange(len(demos)), 100_000, np.random.default_rng(0))
"""


def make_archive(path: Path, steps: int) -> None:
    """Recorded demonstrations of LENGTH steps each."""
    rng = np.random.default_rng(0)
    num = steps // LENGTH
    rows = num * (LENGTH + 1)
    np.savez(
        path,
        states=rng.normal(size=(rows, 4)),
        controls=rng.normal(size=(rows, 1)),
        time=np.tile(0.02 * np.arange(LENGTH + 1), num),
        offsets=np.arange(num + 1) * (LENGTH + 1),
    )


def peak_mb(code: str) -> tuple[float, float]:
    """Peak memory of a process that does this [MB], and how long it took [s]."""
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


if __name__ == "__main__":
    main()
