"""A study killed with SIGKILL at ten random moments, and run again each time, beside one left alone.

    python benchmarks/study_kills.py [--study NAME] [--kills N] [--out DIR]

Prints whether both ended with the same units, the same results and the same tables, and what the kills cost.
Seven minutes on two cores.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

SPAN = (0.1, 1.5)
"""Kills come after this share of what would spread them over an undisturbed run."""
MEASURED = ("seconds", "resumed", "checksum")
"""What a result says of the clock, and the seal over it."""


def command(study: str, out: Path) -> list[str]:
    return [sys.executable, "-m", "planspace", "study", study, "--budget", "smoke", "--out", str(out)]


def run(words: list[str], seconds: float | None = None) -> bool:
    """Whether it came to its end; after so many seconds it alone is killed: its workers must notice."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        if process.wait(seconds) != 0:
            sys.exit(f"{' '.join(words)} failed with {process.returncode}")
        return True
    except subprocess.TimeoutExpired:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        return False


def results(out: Path) -> dict[str, Any]:
    found = {}
    for file in sorted((out / "units").glob("*.json")):  # not what a kill left half written
        result = json.loads(file.read_text())
        found[file.name] = {key: value for key, value in result.items() if key not in MEASURED}
    return found


def tables(study: str, out: Path) -> dict[str, Any]:
    whole = json.loads((out / f"{study}-smoke" / "tables.json").read_text())
    return {key: value for key, value in whole.items() if key != "time"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--study", default="paper")
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("runs/study-kills"))
    options = parser.parse_args()
    alone, killed = options.out / "alone", options.out / "killed"
    began = time.monotonic()
    run(command(options.study, alone))
    undisturbed = time.monotonic() - began
    rng, kills, moments, worked = random.Random(0), 0, [], 0.0
    while True:
        limit = rng.uniform(*SPAN) * undisturbed / options.kills if kills < options.kills else None
        began = time.monotonic()
        ended = run(command(options.study, killed), limit)
        worked += time.monotonic() - began
        if ended:
            break
        kills += 1
        moments.append(f"{worked:.0f}")
    print("command: python benchmarks/study_kills.py --study", options.study, "--kills", options.kills)
    print(f"killed {kills} times, after {', '.join(moments)} s of work")
    ours, theirs = results(killed), results(alone)
    print(f"units: {len(ours)} and {len(theirs)}; the same: {ours.keys() == theirs.keys()}")
    print(f"results the same: {ours == theirs}")
    print(f"tables the same: {tables(options.study, killed) == tables(options.study, alone)}")
    print(f"undisturbed {undisturbed:.0f} s, killed {worked:.0f} s in all: {worked / undisturbed:.2f} times")


if __name__ == "__main__":
    main()
