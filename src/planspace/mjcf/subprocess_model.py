"""Untrusted models: read and compiled in a subprocess with limits on memory and time.

If the subprocess crashes, hangs or runs out of memory, this process raises an error. The subprocess returns
text that compiles within the limits.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from planspace.errors import PlanspaceError, UsageError

MEMORY_BYTES = 4 << 30
CPU_S, WALL_S = 60, 120


def read_model_in_subprocess(path: Path, joints: Sequence[str] | None = None) -> str:
    """Call `read_model` in a subprocess.

    Raises:
        PlanspaceError: the model cannot be read, or does not compile within the limits.
        UsageError: a joint is not in the model.
    """
    request = {"path": str(path.absolute()), "joints": None if joints is None else list(joints)}
    return _run_subprocess(request, str(path))


def check_compiles(xml: str) -> None:
    """Check in a subprocess that a model's text compiles.

    Raises:
        PlanspaceError: the model does not compile within the limits.
    """
    _run_subprocess({"xml": xml}, "the model")


def _run_subprocess(request: dict[str, object], where: str) -> str:
    try:
        done = subprocess.run(
            [sys.executable, "-m", "planspace.mjcf.subprocess_model"],
            input=json.dumps({**request, "memory_bytes": MEMORY_BYTES, "cpu_s": CPU_S}).encode(),
            capture_output=True,
            timeout=WALL_S,
            check=False,
        )
        answer = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError):
        raise PlanspaceError(
            f"{where} does not compile within {CPU_S} s of CPU time and {MEMORY_BYTES >> 30} GiB of memory, "
            "or crashes MuJoCo."
        ) from None
    if "error" in answer:
        raise (UsageError if answer["usage"] else PlanspaceError)(answer["error"])
    return str(answer["text"])


def _main() -> None:
    """Read one request from standard input and write one answer to standard output."""
    import os

    request = json.load(sys.stdin)
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what MuJoCo prints goes to standard error
    _limit_resources(request["memory_bytes"], request["cpu_s"])
    from planspace.mjcf.compile import load_model
    from planspace.mjcf.read import read_model

    try:
        if "path" in request:
            text = read_model(Path(request["path"]), request["joints"])
        else:
            text = request["xml"]
            load_model(text)
        answer = {"text": text}
    except PlanspaceError as error:
        answer = {"error": str(error), "usage": isinstance(error, UsageError)}
    json.dump(answer, out)
    out.flush()


def _limit_resources(memory_bytes: int, cpu_s: int) -> None:
    try:
        import resource
    except ImportError:  # Windows: only the time limit applies
        return
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    _main()
