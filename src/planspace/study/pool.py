"""Worker processes on this machine. Each runs one unit on its own cores, and is replaced if it dies."""

import contextlib
import multiprocessing
import os
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Protocol, runtime_checkable

from planspace.errors import PlanspaceError
from planspace.storage.json_files import read_json, write_json
from planspace.study.execute import execute
from planspace.study.unit import Unit
from planspace.workers import available_cores, count_cores, exit_with_parent, worker_environment

REFRESH_S = 1.0
"""Seconds that a pool waits for a unit to end."""
PATIENCE_S, REMIND_S = 30.0, 5.0
"""A worker that stops gets this time [s] to save its work, and repeated requests at this interval [s]."""
INTERRUPTED = 130
"""Exit code of an interrupted worker."""


@runtime_checkable
class Pool(Protocol):
    """Runs units. `LocalPool` runs them on this machine, `RayPool` on a cluster."""

    @property
    def size(self) -> int:
        """Number of units that run at a time."""
        ...

    def start(self, unit: Unit) -> None:
        """Start a unit. The units that it needs are finished."""
        ...

    def wait(self) -> Sequence[tuple[Unit, str | None]]:
        """Wait briefly for units to end, and return those that ended with their errors."""
        ...

    def stop(self) -> None:
        """Stop the running units, which save their work."""
        ...


@dataclass(frozen=True)
class _Worker:
    unit: Unit
    process: SpawnProcess
    slot: int


class LocalPool:
    """A pool of processes that share this machine's cores."""

    def __init__(self, out: Path, size: int):
        """Make a pool for a folder of studies, with at most one process per core."""
        self.size, self._out = min(size, count_cores()), out
        self._free = list(range(self.size))
        self._workers: list[_Worker] = []

    def start(self, unit: Unit) -> None:
        """Start a unit in a separate process."""
        _error_file(unit, self._out).unlink(missing_ok=True)  # from an earlier attempt
        context = multiprocessing.get_context("spawn")  # a fork would copy thread pools without their threads
        slot = self._free.pop()
        process = context.Process(target=_work, args=(unit, self._out, slot, self.size), name=unit.name)
        with worker_environment():
            process.start()
        self._workers.append(_Worker(unit, process, slot))

    def wait(self) -> Sequence[tuple[Unit, str | None]]:
        """Return the units that have ended, after at most a second."""
        wait([worker.process.sentinel for worker in self._workers], timeout=REFRESH_S)
        ended = [worker for worker in self._workers if not worker.process.is_alive()]
        for worker in ended:
            self._workers.remove(worker)
            self._free.append(worker.slot)
        return [(worker.unit, self._error(worker)) for worker in ended]

    def stop(self) -> None:
        """Tell the workers to save and exit."""
        deadline = time.monotonic() + PATIENCE_S
        while alive := [worker.process for worker in self._workers if worker.process.is_alive()]:
            for process in alive:  # repeatedly: the interpreter can lose an interrupt in a callback
                process.terminate() if time.monotonic() < deadline else process.kill()
            wait([process.sentinel for process in alive], timeout=REMIND_S)

    def _error(self, worker: _Worker) -> str | None:
        code = worker.process.exitcode or 0
        if code == 0:
            return None
        if code < 0:
            return f"its process was killed by {signal.Signals(-code).name}"
        file = _error_file(worker.unit, self._out)
        return str(read_json(file)["error"]) if file.exists() else f"its process exited with code {code}"


def _error_file(unit: Unit, out: Path) -> Path:
    return out / "work" / f"{unit.name}.error.json"


def _work(unit: Unit, out: Path, slot: int, workers: int) -> None:
    """Run one unit in a worker process."""
    os.setpgid(0, 0)  # only the parent receives Ctrl-C; it stops the workers
    signal.signal(signal.SIGTERM, _interrupt)
    exit_with_parent()
    cores = available_cores()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores[slot::workers] or cores)
    with open(out / "work" / f"{unit.name}.log", "a", buffering=1) as log, contextlib.redirect_stderr(log):
        try:
            execute(unit, out)
        except KeyboardInterrupt:
            sys.exit(INTERRUPTED)
        except Exception as error:
            traceback.print_exc()
            with contextlib.suppress(PlanspaceError):  # the disk may be full
                write_json(_error_file(unit, out), {"error": one_line(error)})
            sys.exit(1)


def one_line(error: Exception) -> str:
    """Format an error in one line, with its type if it is not a PlanspaceError."""
    text = " ".join(str(error).split())
    return text if isinstance(error, PlanspaceError) else f"{type(error).__name__}: {text}"


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt
