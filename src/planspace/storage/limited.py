"""Work on files that may crash, hang or exhaust a library: done in a subprocess with limits.

A module that does such work calls `ask` to start itself as a subprocess, and `serve` when it is started.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from typing import Any

from planspace.errors import PlanspaceError, UsageError

Work = Callable[[dict[str, Any]], Mapping[str, Any]]
"""The request to the answer, both plain data."""


def ask(
    module: str,
    request: Mapping[str, Any],
    *,
    memory_bytes: int,
    cpu_s: int,
    wall_s: float | int,
    failure: str,
) -> dict[str, Any]:
    """Have a module do its work in a subprocess.

    Args:
        module: full name of a module that calls `serve` when it is run.
        request: plain data.
        memory_bytes: largest memory of the subprocess.
        cpu_s: most CPU time of the subprocess [s].
        wall_s: most wall time of the subprocess [s].
        failure: the message if the subprocess crashes or exceeds a limit.

    Returns:
        The answer.

    Raises:
        PlanspaceError: the work raised it, or the subprocess crashed or exceeded a limit.
        UsageError: the work raised it.
    """
    limits = {"memory_bytes": memory_bytes, "cpu_s": cpu_s}
    try:
        done = subprocess.run(
            [sys.executable, "-m", module],
            input=json.dumps({"request": request, **limits}).encode(),
            capture_output=True,
            timeout=wall_s,
            check=False,
        )
        answer = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError):
        raise PlanspaceError(failure) from None
    if "error" in answer:
        raise (UsageError if answer["usage"] else PlanspaceError)(answer["error"])
    return answer


def serve(work: Work) -> None:
    """Read one request from standard input, do the work within the limits, and write one answer.

    Args:
        work: called once; it should import what it needs itself, so that the limits hold there, too.
    """
    asked = json.load(sys.stdin)
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print goes to standard error
    _limit_resources(asked["memory_bytes"], asked["cpu_s"])
    try:
        answer = work(asked["request"])
    except PlanspaceError as error:
        answer = {"error": str(error), "usage": isinstance(error, UsageError)}
    json.dump(answer, out)
    out.flush()


def _limit_resources(memory_bytes: int, cpu_s: int) -> None:
    """Limit the memory and the CPU time of this process."""
    try:
        import resource
    except ImportError:  # Windows: only the time limit applies
        return
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
