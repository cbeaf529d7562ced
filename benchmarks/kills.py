"""Kill every long command repeatedly, restart it each time, and compare the result with an undisturbed run.

    python benchmarks/kills.py [--kills N] [--life S] [--scale small|long] [--only plan,embed,train,study]
        [--out DIR]

Killed runs use another hash seed, working folder and locale than the undisturbed run, and on the small scale
only one core. XLA uses one thread in both (NPROC=1), and both start without compiled programs. A command that
finishes before the requested number of kills is run again in a new folder.

For each command, the table shows whether all results are equal, and the CPU time of the killed runs relative
to the undisturbed run. It includes all processes and all restarts. The exit code is 1 if a result differs, or
if on the long scale the relative CPU time exceeds `MAX_WORK`. The long scale, with `--life` seconds between
kills on average, takes 90 minutes on two cores. The tests run the small scale.
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
from planspace.embed.saved_embedding import load_embedding
from planspace.storage.arrays import read_arrays
from planspace.workers import WORKER_ENVIRONMENT

MEASURED = ("seconds", "resumed", "checksum", "cores", "saved", "time")
"""Keys that depend on the clock or the machine; they are not compared."""
MAX_WORK = 1.5
"""Largest accepted CPU time of a killed command, relative to an undisturbed run."""
PR_SET_CHILD_SUBREAPER = 36
"""Option of prctl on Linux: orphaned workers of a killed command become children of this process."""
Content = dict[str, Any]


@dataclass(frozen=True)
class Command:
    """A command that can be killed."""

    words: Callable[[Path, Path], list[str]]
    """Arguments after `planspace`, given the folder of the inputs and the output folder."""
    small: str
    """Options on the small scale."""
    long: str
    """Options on the long scale."""
    content: Callable[[Path], Content]
    """Reads the result that is compared."""

    def line(self, scale: str, given: Path, out: Path) -> list[str]:
        """The complete command line."""
        options = (self.small if scale == "small" else self.long).split()
        return [sys.executable, "-m", "planspace", *self.words(given, out), *options, "--out", str(out)]


def demos_content(out: Path) -> Content:
    return {"hash": load_demos(out).hash, **log_content(out)}


def log_content(out: Path) -> Content:
    """All rows of a log."""
    rows = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    return {f"row {i}": {k: v for k, v in row.items() if k not in MEASURED} for i, row in enumerate(rows)}


def embedding_content(out: Path) -> Content:
    return {"hash": load_embedding(out).hash, **log_content(out)}


def training_content(out: Path) -> Content:
    files = (out / "history.safetensors", out / "policies.safetensors")
    return {k: v.tobytes() for file in files for k, v in read_arrays(file).items()} | log_content(out)


def study_content(out: Path) -> Content:
    found = {}
    for file in sorted((out / "units").glob("*.json")):  # without temporary files of killed runs
        result = json.loads(file.read_text())
        found[file.name] = {key: value for key, value in result.items() if key not in MEASURED}
    (tables,) = out.glob("*/tables.json")
    summary = json.loads(tables.read_text())
    return {**found, "tables": {key: value for key, value in summary.items() if key != "time"}}


COMMANDS = {
    "plan": Command(
        lambda given, out: ["plan", "cartpole-swingup"],
        "--num 20 --restarts 1 --polish-max-iterations 10",
        "--num 500",
        demos_content,
    ),
    "embed": Command(
        lambda given, out: ["embed", str(given / "plan")],
        "--steps 600 --batch 64 --seeds 2",
        "--steps 30000 --seeds 3",
        embedding_content,
    ),
    "train": Command(
        lambda given, out: ["train", "cartpole-swingup"],
        "--steps 60000 --seeds 2",
        "--steps 8000000 --seeds 2",
        training_content,
    ),
    "study": Command(lambda given, out: ["study", "paper", "--budget", "smoke"], "", "", study_content),
}


def environment(other: bool, cache: Path) -> dict[str, str]:
    """Environment variables, with an empty cache of compiled programs."""
    changes = {"PYTHONHASHSEED": "0", "LC_ALL": "C", "TZ": "UTC"}
    if other:
        changes = {"PYTHONHASHSEED": "12345", "LC_ALL": "C.UTF-8", "TZ": "Asia/Tokyo"}
    return {**os.environ, **WORKER_ENVIRONMENT, **changes, "XDG_CACHE_HOME": str(cache)}


def run(
    line: list[str], cache: Path, *, other: bool, one_core: bool = False, seconds: float | None = None
) -> bool:
    """Run a command and return whether it finished.

    After `seconds`, the main process is killed; its workers must exit by themselves.
    """
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
    """CPU time of all child processes, after waiting until they have ended."""
    try:
        while True:
            os.wait()
    except ChildProcessError:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def try_command(name: str, scale: str, kills: int, life: float, out: Path, rng: random.Random) -> bool:
    """Test one command, print its row, and return whether it passed."""
    command, given = COMMANDS[name], out / "undisturbed"
    undisturbed, small = given / name, scale == "small"
    line, cache = command.line(scale, given, undisturbed), given / f"{name}-cache"
    before, began = cpu_seconds(), time.monotonic()
    run(line, cache, other=False)
    wall_time, work = time.monotonic() - began, cpu_seconds() - before
    start = 0.0
    if small:  # measure a start: a run with nothing left to do
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
            shortest, longest = 0.2 * start, start + 2.2 * max(wall_time - start, 0.1) / kills / rounds
        while not ended:
            limit = rng.uniform(shortest, longest) if done < kills else None
            ended = run(line, cache, other=True, one_core=small, seconds=limit)
            done += not ended
        same = same and command.content(undisturbed) == command.content(killed)
    ratio = (cpu_seconds() - before) / (rounds * work)
    row = (name, done, rounds, f"{wall_time:.0f}", f"{work:.0f}", f"{ratio:.2f}", "yes" if same else "NO")
    print("|", " | ".join(map(str, row)), "|", flush=True)
    return same and (small or ratio <= MAX_WORK)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kills", type=int, default=50, help="kills per command")
    parser.add_argument("--life", type=float, default=15.0, help="mean seconds until a kill, long scale")
    parser.add_argument("--scale", choices=("small", "long"), default="long")
    parser.add_argument("--only", default=",".join(COMMANDS))
    parser.add_argument("--out", type=Path, default=Path("runs/kills"))
    options = parser.parse_args()
    out = options.out.absolute()
    print("command: python benchmarks/kills.py", " ".join(sys.argv[1:]))
    columns = (
        "command",
        "kills",
        "runs",
        "undisturbed [s]",
        "undisturbed [CPU s]",
        "relative CPU time",
        "equal",
    )
    print("|", " | ".join(columns), "|")
    print("|---|---|---|---|---|---|---|", flush=True)
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    rng = random.Random(0)
    names = options.only.split(",")
    same = [try_command(name, options.scale, options.kills, options.life, out, rng) for name in names]
    sys.exit(0 if all(same) else 1)


if __name__ == "__main__":
    main()
