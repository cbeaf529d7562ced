"""Worker processes: their number, their environment, and calls that they make for this process.

The calls travel as pickles through pipes between processes of one command; nothing is stored as a pickle.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue
from types import MappingProxyType
from typing import Any

from planspace.errors import PlanspaceError


def available_cores() -> list[int]:
    """The CPU cores that this process may use; fewer than the machine has if the process is pinned."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def count_cores() -> int:
    """The number of CPU cores that this process may use."""
    return len(available_cores())


ORPHAN_EXIT_CODE = 130
"""Exit code of a worker whose parent has died."""
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NPROC"), "1")
CPU_INFO = Path("/proc/cpuinfo")
"""The file in which Linux describes the CPU."""
_HAS_AVX2 = CPU_INFO.exists() and " avx2 " in CPU_INFO.read_text()
_KERNELS = {"OPENBLAS_CORETYPE": "Haswell"} if _HAS_AVX2 else {}
WORKER_ENVIRONMENT: dict[str, str] = _ONE_THREAD | _KERNELS
"""Environment of worker processes, in which results do not depend on the machine.

The linear algebra of NumPy and XLA (NPROC) uses one thread, because the last bits of its results depend on
the number of threads. On Linux, OpenBLAS uses the kernels for AVX2, which every x86-64 CPU with AVX2 can run.
By default it chooses kernels for the CPU at hand, which sum in a different order; plans would then differ.
"""


# --- calls in other processes ---------------------------------------------------------------------------


class WorkerDied(Exception):
    """A worker process ended during a call."""

    def __init__(self, exit_code: int):
        super().__init__(f"exit code {exit_code}")
        self.exit_code = exit_code
        """Negative if a signal of this number killed the process."""


class WorkerPool:
    """Worker processes that make calls, in the order in which they are submitted.

    A worker does not import the `__main__` of this process, so a script needs no guard, and functions and
    classes of a script, a prompt or a notebook are sent by value. Ctrl-C does not reach the workers. They
    are killed at the end of the block, and exit by themselves when this process dies.
    """

    def __init__(self, num: int, environment: Mapping[str, str] = MappingProxyType({})):
        """Start the processes.

        Args:
            num: their number.
            environment: variables to set before they import anything.
        """
        self._calls: SimpleQueue[tuple[Future, bytes] | None] = SimpleQueue()
        self._workers = [_Worker(environment) for _ in range(num)]
        self._threads = [  # daemons, so that this process can always exit
            threading.Thread(target=_drive, args=(worker, self._calls), daemon=True)
            for worker in self._workers
        ]
        for thread in self._threads:
            thread.start()

    def submit(self, function: Callable[..., Any], *args: Any) -> Future:
        """Call a function in a worker.

        Returns:
            What the function will return or raise. It raises `WorkerDied` if the worker ends before that;
            later calls may then do so too.
        """
        future: Future = Future()
        self._calls.put((future, pack((function, args))))
        return future

    def __enter__(self) -> "WorkerPool":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def terminate(self) -> None:
        """Send SIGTERM to the processes, once, and return at once."""
        for worker in self._workers:
            worker.terminate()

    def close(self) -> None:
        """Kill the processes."""
        for worker in self._workers:
            worker.kill()
        for _thread in self._threads:
            self._calls.put(None)
        for thread in self._threads:
            thread.join()


def pack(value: Any) -> bytes:
    """Pickle a value for a worker process; what `__main__` defines is included by value."""
    import cloudpickle

    return cloudpickle.dumps(value)


class _Worker:
    def __init__(self, environment: Mapping[str, str]):
        path = [str(folder) for folder in sys.path]
        start = f"import sys; sys.path[:] = {path!r}; from planspace.workers import serve; serve()"
        self._process = subprocess.Popen(
            [sys.executable, *(f"-W{option}" for option in sys.warnoptions), "-c", start],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | dict(environment),
            process_group=0
            if os.name == "posix"
            else None,  # Ctrl-C is for the parent, which kills the worker
        )

    def call(self, message: bytes) -> Any:
        """Send a packed call and return what it returned, or raise what it raised."""
        requests, answers = self._process.stdin, self._process.stdout
        assert requests is not None and answers is not None
        try:
            _send(requests, message)
            answer = _receive(answers)
        except (OSError, EOFError, ValueError):  # ValueError: a pipe was closed
            self.kill()
            raise WorkerDied(self._process.wait()) from None
        returned, value = pickle.loads(answer)
        if returned:
            return value
        raise value

    def terminate(self) -> None:
        """Send SIGTERM to the process."""
        self._process.terminate()

    def kill(self) -> None:
        """End the process and those that it started."""
        if self._process.poll() is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            if os.name == "posix":
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()

    def close(self) -> None:
        """End the process and release its pipes."""
        self.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):  # what was still to be written
                pipe.close()  # pyright: ignore


def _drive(worker: _Worker, calls: SimpleQueue[tuple[Future, bytes] | None]) -> None:
    """Have a worker make calls until there are no more."""
    while (call := calls.get()) is not None:
        future, message = call
        try:
            future.set_result(worker.call(message))
        except BaseException as error:
            future.set_exception(error)
    worker.close()


def serve() -> None:
    """Make the calls that arrive on standard input. The process ends when its parent closes it or dies."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # text that a call prints must not mix with the answers
    calls: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_read_calls, args=(requests, calls), daemon=True).start()
    while True:
        answer = _answer(calls.get())
        sys.stdout.flush()
        try:
            _send(answers, answer)
        except OSError:  # the parent has died
            os._exit(ORPHAN_EXIT_CODE)


def _read_calls(requests: Any, calls: SimpleQueue[bytes]) -> None:
    try:
        while True:
            calls.put(_receive(requests))
    finally:
        os._exit(ORPHAN_EXIT_CODE)


def _answer(message: bytes) -> bytes:
    try:
        function, args = pickle.loads(message)
        return pack((True, function(*args)))
    except Exception as error:
        if not isinstance(error, PlanspaceError):
            error.add_note(f"In a worker process:\n{traceback.format_exc()}")
        try:
            answer = pack((False, error))
            pickle.loads(answer)  # some exceptions cannot be read again
            return answer
        except Exception:
            return pack((False, RuntimeError(f"{type(error).__name__}: {error}")))


def _send(pipe: Any, data: bytes) -> None:
    pipe.write(len(data).to_bytes(8, "little") + data)
    pipe.flush()


def _receive(pipe: Any) -> bytes:
    size = pipe.read(8)
    data = pipe.read(int.from_bytes(size, "little"))
    if len(size) < 8 or len(data) < int.from_bytes(size, "little"):
        raise EOFError
    return data
