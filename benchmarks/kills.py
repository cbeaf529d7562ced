"""Every long command killed with SIGKILL again and again, and run again each time, beside one left alone.

    python benchmarks/kills.py [--kills N] [--life S] [--scale small|long] [--only plan,embed,train,study]
        [--out DIR]

The one that is killed has another hash seed, working folder and locale, and on the small scale one core; XLA
computes on one thread in both (NPROC=1), and neither finds anything compiled before. What ends before it was
killed often enough is done once more, in a new folder. Prints, for each command, whether all ended with the
same content, and the work of one that was killed, as a multiple of one left alone: seconds of CPU from its
first start to its end, of all its processes, with what each start costs. Ends with 1 if a content differs, or
if on the long scale, where it lives so many seconds on average, the work is more than `MOST_WORK` times. The
long scale takes an hour and a half on two cores; the tests do the small one.
"""

import argparse
import ctypes
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planspace.demos.load import load_demos
from planspace.embed.embedding import load_embedding
from planspace.storage.arrays import read_arrays
from planspace.workers import WORKER_ENVIRONMENT

MEASURED = ("seconds", "resumed", "checksum", "cores", "saved", "time")
"""What results and logs say of the clock and the machine, and the seal over them."""
MOST_WORK = 1.5
"""Killed again and again, a long command may take so many times the work of one left alone."""
PR_SET_CHILD_SUBREAPER = 36
"""Of Linux's prctl: the workers that a killed command leaves behind become children of this process."""
Content = dict[str, Any]


@dataclass(frozen=True)
class Command:
    """A command that can be killed."""

    words: Callable[[Path, Path], list[str]]
    """What follows `planspace`, for the folder of what it reads and its own."""
    small: str
    long: str
    content: Callable[[Path], Content]

    def line(self, scale: str, given: Path, out: Path) -> list[str]:
        """The whole command."""
        options = (self.small if scale == "small" else self.long).split()
        return [sys.executable, "-m", "planspace", *self.words(given, out), *options, "--out", str(out)]


def of_demos(out: Path) -> Content:
    return {"hash": load_demos(out).hash, **of_log(out)}


def of_log(out: Path) -> Content:
    """Every row, and each of them once."""
    rows = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    return {f"row {i}": {k: v for k, v in row.items() if k not in MEASURED} for i, row in enumerate(rows)}


def of_embedding(out: Path) -> Content:
    return {"hash": load_embedding(out).hash, **of_log(out)}


def of_training(out: Path) -> Content:
    files = (out / "history.safetensors", out / "policies.safetensors")
    return {k: v.tobytes() for file in files for k, v in read_arrays(file).items()} | of_log(out)


def of_study(out: Path) -> Content:
    found = {}
    for file in sorted((out / "units").glob("*.json")):  # not what a kill left half written
        result = json.loads(file.read_text())
        found[file.name] = {key: value for key, value in result.items() if key not in MEASURED}
    (tables,) = out.glob("*/tables.json")
    summary = json.loads(tables.read_text())
    return {**found, "tables": {key: value for key, value in summary.items() if key != "time"}}


COMMANDS = {
    "plan": Command(
        lambda given, out: ["plan", "cartpole-swingup"],
        "--num 20 --restarts 1 --settings polish_max_iterations=10",
        "--num 500",
        of_demos,
    ),
    "embed": Command(
        lambda given, out: ["embed", str(given / "plan")],
        "--steps 600 --batch 64 --seeds 2",
        "--steps 30000 --seeds 3",
        of_embedding,
    ),
    "train": Command(
        lambda given, out: ["train", "cartpole-swingup"],
        "--steps 60000 --seeds 2",
        "--steps 8000000 --seeds 2",
        of_training,
    ),
    "study": Command(lambda given, out: ["study", "paper", "--budget", "smoke"], "", "", of_study),
}


def environment(other: bool, cache: Path) -> dict[str, str]:
    """Its own folder for compiled programs, too: each run begins without any."""
    changes = {"PYTHONHASHSEED": "0", "LC_ALL": "C", "TZ": "UTC"}
    if other:
        changes = {"PYTHONHASHSEED": "12345", "LC_ALL": "C.UTF-8", "TZ": "Asia/Tokyo"}
    return {**os.environ, **WORKER_ENVIRONMENT, **changes, "XDG_CACHE_HOME": str(cache)}


def run(
    line: list[str], cache: Path, *, other: bool, one_core: bool = False, seconds: float | None = None
) -> bool:
    """Whether it came to its end; after so many seconds it alone is killed: its workers must notice."""
    cores = sorted(os.sched_getaffinity(0))
    process = subprocess.Popen(
        line,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=environment(other, cache),
        cwd=tempfile.gettempdir() if other else "/",
        preexec_fn=(lambda: os.sched_setaffinity(0, cores[:1])) if one_core else None,
    )
    try:
        _, complaint = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        return False
    if process.returncode != 0:
        sys.exit(f"{' '.join(line)} failed with {process.returncode}: {complaint.decode()[-500:]}")
    return True


def cpu_seconds() -> float:
    """Of all that was started until now, once it has ended: workers that were left behind notice it soon."""
    try:
        while True:
            os.wait()
    except ChildProcessError:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def try_command(name: str, scale: str, kills: int, life: float, out: Path, rng: random.Random) -> bool:
    """Prints a line of the table; whether the content is the same, and the work not much more."""
    command, given = COMMANDS[name], out / "alone"
    alone, small = given / name, scale == "small"
    line, cache = command.line(scale, given, alone), given / f"{name}-cache"
    before, began = cpu_seconds(), time.monotonic()
    run(line, cache, other=False)
    undisturbed, work = time.monotonic() - began, cpu_seconds() - before
    start = 0.0
    if small:  # a life must be longer than a start: a run with nothing left to do
        began = time.monotonic()
        run(line, cache, other=False)
        start = time.monotonic() - began
    done, rounds, same, before = 0, 0, True, cpu_seconds()
    while done < kills or not rounds:
        rounds, ended = rounds + 1, False
        killed = out / f"killed-{rounds}" / name
        line, cache = command.line(scale, given, killed), killed.with_name(f"{name}-cache")
        shortest, longest = 0.0, 2 * life
        if small:
            shortest, longest = 0.2 * start, start + 2.2 * max(undisturbed - start, 0.1) / kills / rounds
        while not ended:
            limit = rng.uniform(shortest, longest) if done < kills else None
            ended = run(line, cache, other=True, one_core=small, seconds=limit)
            done += not ended
        same = same and command.content(alone) == command.content(killed)
    ratio = (cpu_seconds() - before) / (rounds * work)
    row = (name, done, rounds, f"{undisturbed:.0f}", f"{work:.0f}", f"{ratio:.2f}", "yes" if same else "NO")
    print("|", " | ".join(map(str, row)), "|", flush=True)
    return same and (small or ratio <= MOST_WORK)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kills", type=int, default=50, help="of each command")
    parser.add_argument("--life", type=float, default=15.0, help="seconds until a kill, on the long scale")
    parser.add_argument("--scale", choices=("small", "long"), default="long")
    parser.add_argument("--only", default=",".join(COMMANDS))
    parser.add_argument("--out", type=Path, default=Path("runs/kills"))
    options = parser.parse_args()
    out = options.out.absolute()
    print("command: python benchmarks/kills.py", " ".join(sys.argv[1:]))
    print("| command | kills | runs | alone [s] | alone [CPU s] | work, killed / alone | same content |")
    print("|---|---|---|---|---|---|---|", flush=True)
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    rng = random.Random(0)
    names = options.only.split(",")
    same = [try_command(name, options.scale, options.kills, options.life, out, rng) for name in names]
    sys.exit(0 if all(same) else 1)


if __name__ == "__main__":
    main()
