"""Models of strangers, read and compiled in a process of its own, within bounds of memory and time.

What crashes, hangs or fills the memory there is an error here. What comes back is text, which is known to
compile within the bounds.
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
    """As `read_model`, in a process of its own.

    Raises:
        PlanspaceError: it cannot be read or does not compile, or not within the bounds.
        UsageError: a joint is not in the model.
    """
    return _asked(
        {"path": str(path.absolute()), "joints": None if joints is None else list(joints)}, str(path)
    )


def check_compiles(xml: str) -> None:
    """Sees in a process of its own whether a model's text compiles.

    Raises:
        PlanspaceError: it does not, or not within the bounds.
    """
    _asked({"xml": xml}, "the model")


def _asked(question: dict[str, object], where: str) -> str:
    try:
        done = subprocess.run(
            [sys.executable, "-m", "planspace.mjcf.subprocess_model"],
            input=json.dumps({**question, "memory_bytes": MEMORY_BYTES, "cpu_s": CPU_S}).encode(),
            capture_output=True,
            timeout=WALL_S,
            check=False,
        )
        answer = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError):
        raise PlanspaceError(
            f"{where} does not compile within {CPU_S} s of one processor and {MEMORY_BYTES >> 30} GiB of "
            "memory, or crashes MuJoCo; planspace does not take it."
        ) from None
    if "error" in answer:
        raise (UsageError if answer["usage"] else PlanspaceError)(answer["error"])
    return str(answer["text"])


def _answer() -> None:
    """What the process does: one question on standard input, one answer on standard output."""
    import os

    question = json.load(sys.stdin)
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # MuJoCo may print
    _bound(question["memory_bytes"], question["cpu_s"])
    from planspace.mjcf.compile import load_model
    from planspace.mjcf.read import read_model

    try:
        if "path" in question:
            text = read_model(Path(question["path"]), question["joints"])
        else:
            text = question["xml"]
            load_model(text)
        answer = {"text": text}
    except PlanspaceError as error:
        answer = {"error": str(error), "usage": isinstance(error, UsageError)}
    json.dump(answer, out)
    out.flush()


def _bound(memory_bytes: int, cpu_s: int) -> None:
    try:
        import resource
    except ImportError:  # Windows has the time limit alone
        return
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    _answer()
