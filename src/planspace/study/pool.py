"""Worker processes on this machine. Each runs one unit on its own cores, and is replaced if it dies."""

import contextlib
import os
import signal
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from planspace.errors import PlanspaceError
from planspace.study.execute import execute
from planspace.study.unit import Unit
from planspace.workers import WORKER_ENVIRONMENT, WorkerDied, WorkerPool, available_cores, count_cores

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

    @property
    def cores(self) -> float:
        """Number of cores of each running unit."""
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
class _Running:
    """A running unit, in a process of its own."""

    unit: Unit
    worker: WorkerPool
    ended: Future
    slot: int


class LocalPool:
    """A pool of processes that share this machine's cores. Scripts that use it need no `__main__` guard."""

    def __init__(self, out: Path, size: int):
        """Make a pool for a folder of studies, with at most one process per core."""
        self.size, self._out = min(size, count_cores()), out
        self.cores = count_cores() / self.size
        self._free = list(range(self.size))
        self._running: list[_Running] = []

    def start(self, unit: Unit) -> None:
        """Start a unit in a separate process."""
        slot, worker = self._free.pop(), WorkerPool(1, WORKER_ENVIRONMENT)
        ended = worker.submit(_work, unit, self._out, slot, self.size)
        self._running.append(_Running(unit, worker, ended, slot))

    def wait(self) -> Sequence[tuple[Unit, str | None]]:
        """Return the units that have ended, after at most a second."""
        wait([running.ended for running in self._running], REFRESH_S, FIRST_COMPLETED)
        ended = [running for running in self._running if running.ended.done()]
        for running in ended:
            running.worker.close()
            self._running.remove(running)
            self._free.append(running.slot)
        return [(running.unit, _error(running.ended)) for running in ended]

    def stop(self) -> None:
        """Tell the workers to save and exit."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and (alive := [r for r in self._running if not r.ended.done()]):
            for running in alive:  # repeatedly: the interpreter can lose an interrupt in a callback
                running.worker.terminate()
            wait([running.ended for running in alive], REMIND_S)
        for running in self._running:
            running.worker.close()


def _error(ended: Future) -> str | None:
    """The error of a unit, or how its process died."""
    try:
        return ended.result()
    except WorkerDied as death:
        if death.exit_code < 0:
            return f"its process was killed by {signal.Signals(-death.exit_code).name}"
        return f"its process exited with code {death.exit_code}"
    except Exception as error:  # the unit could not be read in the worker
        return one_line(error)


def _work(unit: Unit, out: Path, slot: int, workers: int) -> str | None:
    """Run one unit in a worker process, and return its error."""
    signal.signal(signal.SIGTERM, _interrupt)
    cores = available_cores()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores[slot::workers] or cores)
    with (
        open(out / "work" / f"{unit.name}.log", "a", buffering=1) as log,
        contextlib.redirect_stdout(log),
        contextlib.redirect_stderr(log),
    ):
        try:
            execute(unit, out)
        except KeyboardInterrupt:
            os._exit(INTERRUPTED)
        except Exception as error:
            traceback.print_exc()
            return one_line(error)
    return None


def one_line(error: Exception) -> str:
    """Format an error in one line, with its type if it is not a PlanspaceError."""
    text = " ".join(str(error).split())
    return text if isinstance(error, PlanspaceError) else f"{type(error).__name__}: {text}"


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt
