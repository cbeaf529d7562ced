"""How many processes or threads are worth starting, and how processes keep out of each other's way."""

import multiprocessing
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def available_cores() -> list[int]:
    """CPU cores this process may run on: fewer than the machine has where it is pinned to some."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def count_cores() -> int:
    """How many they are."""
    return len(available_cores())


ORPHANED = 130
"""Exit code of a process whose parent is gone."""
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NPROC"), "1")
CPU_INFO = Path("/proc/cpuinfo")
"""Where Linux describes the CPU."""
_HAS_AVX2 = CPU_INFO.exists() and " avx2 " in CPU_INFO.read_text()
_KERNELS = {"OPENBLAS_CORETYPE": "Haswell"} if _HAS_AVX2 else {}
WORKER_ENVIRONMENT: dict[str, str] = _ONE_THREAD | _KERNELS
"""Environment of a process that works beside others and is to compute what it would anywhere.

Linear algebra takes one thread, NumPy's and XLA's (NPROC), whose results otherwise depend in their last bits
on how many cores there are. OpenBLAS takes the kernels that every x86-64 CPU with AVX2 can run (on Linux);
by default it takes those of the CPU at hand, which sum in another order, and a planner's next plan is then
another.
"""


@contextmanager
def worker_environment() -> Iterator[None]:
    """Processes started meanwhile have `WORKER_ENVIRONMENT`."""
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


def end_with_parent() -> None:
    """Has this process end when the one that started it does, which a kill leaves no time to say so."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(ORPHANED)
