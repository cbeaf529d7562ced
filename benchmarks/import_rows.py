"""Measure how long an import takes and how much memory it needs.

    python benchmarks/import_rows.py [--rows 1000000]

Each source has demonstrations of 500 rows with 6 states, of which one is a wrapped angle, and 2 controls. The
table shows, for a tenth of the rows and for all of them, the seconds and the peak memory of
`planspace demos import` as a process of its own. `uneven` means that the times vary, so that everything is
resampled.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

LENGTH, NUM_STATES, NUM_CONTROLS = 500, 6, 2


def demonstration(rng: np.random.Generator, uneven: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The times, states and controls of one demonstration."""
    steps = rng.uniform(0.02, 0.04, LENGTH) if uneven else np.full(LENGTH, 0.03)
    times = np.cumsum(steps)
    phases = rng.uniform(0, 6, NUM_STATES)
    states = np.sin(times[:, None] * 0.7 + phases)
    states[:, -1] = (times + phases[-1] + np.pi) % (2 * np.pi) - np.pi
    return times, states, rng.normal(size=(LENGTH, NUM_CONTROLS))


def write_csv(file: Path, num: int, uneven: bool) -> None:
    rng = np.random.default_rng(0)
    names = [f"x{i}" for i in range(NUM_STATES - 1)] + ["heading"]
    controls = [f"control{i + 1}" for i in range(NUM_CONTROLS)]
    with file.open("w") as out:
        out.write(",".join(["episode", "frame_index", "timestamp", *names, *controls]) + "\n")
        for e in range(num):
            times, states, held = demonstration(rng, uneven)
            for i, row in enumerate(np.column_stack([times, states, held]).tolist()):
                out.write(f"{e},{i},{','.join(map(repr, row))}\n")


def write_npz(file: Path, num: int, uneven: bool) -> None:
    rng = np.random.default_rng(0)
    times, states, controls = zip(*(demonstration(rng, uneven) for _ in range(num)), strict=True)
    np.savez(
        file,
        time=np.concatenate(times),
        states=np.concatenate(states),
        controls=np.concatenate(controls),
        offsets=LENGTH * np.arange(num + 1),
    )


def measure(source: Path, out: Path) -> tuple[float, float]:
    """Seconds and peak memory [MB] of an import in a process of its own."""
    command = [sys.executable, "-m", "planspace", "demos", "import", str(source), "--out", str(out)]
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - began
    if status:
        raise SystemExit(f"the import of {source} failed: {' '.join(command)}")
    return seconds, usage.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=int, default=1_000_000)
    arguments = parser.parse_args()
    print(f"command: python benchmarks/import_rows.py --rows {arguments.rows}")
    print(f"{'source':<14}{'rows':>10}{'seconds':>10}{'peak MB':>10}")
    for suffix, write in (("csv", write_csv), ("npz", write_npz)):
        for uneven in (False, True):
            for rows in (arguments.rows // 10, arguments.rows):
                with tempfile.TemporaryDirectory() as folder:
                    source = Path(folder) / f"demos.{suffix}"
                    write(source, rows // LENGTH, uneven)
                    seconds, memory = measure(source, Path(folder) / "out")
                name = f"{suffix}{', uneven' if uneven else ''}"
                print(f"{name:<14}{rows:>10}{seconds:>10.1f}{memory:>10.0f}", flush=True)


if __name__ == "__main__":
    main()
