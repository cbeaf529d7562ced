"""How many processes or threads are worth starting."""

import os


def count_cores() -> int:
    """CPU cores this process may run on: fewer than the machine has where it is pinned to some."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
