"""The number of processes and threads to start, and the environment of worker processes."""

import multiprocessing
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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


@contextmanager
def worker_environment() -> Iterator[None]:
    """Give `WORKER_ENVIRONMENT` to the processes that are started inside the block."""
    before = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    os.environ.update(WORKER_ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def exit_with_parent() -> None:
    """Make this worker exit when its parent dies, even if the parent is killed."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(ORPHAN_EXIT_CODE)
