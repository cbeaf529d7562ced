"""How many processes or threads are worth starting, and how processes keep out of each other's way."""

import multiprocessing
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager


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
ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NPROC"), "1"
)
"""Environment of a process whose linear algebra is to take one thread: NumPy's, and XLA's (NPROC), whose
results otherwise depend in their last bits on how many cores there are."""


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes started meanwhile do linear algebra on one thread: there are as many of them as cores."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
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
