"""Run the units of a study on a Ray cluster, as Ray Core tasks.

A task receives the files that its unit needs, and returns the files that the unit wrote. The machines need
the same version of planspace, but no shared file system. Ray replaces a worker that dies. If the new worker
is on the same machine, the unit is resumed from its last checkpoint.
"""

import getpass
import logging
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any

from planspace.errors import PlanspaceError, UsageError, install_command
from planspace.storage.files import make_folder, read_bytes, write_or_link
from planspace.storage.json_files import json_hash
from planspace.storage.runs import lock_folder
from planspace.storage.settings import list_differences
from planspace.study.execute import VERSIONS, execute, folder_of, keep_result, read_result
from planspace.study.pool import REFRESH_S, one_line
from planspace.study.results import UnitResult
from planspace.study.unit import Unit
from planspace.tasks.stored_task import FOLDER
from planspace.workers import WORKER_ENVIRONMENT, available_cores

Files = dict[str, bytes]
"""Contents of files by their paths relative to a folder."""

RETRIES = 3
"""Number of times that Ray restarts a task whose worker died."""
CONNECT_S, PROBE_S = 1.5, 6.0
"""Time limits [s] for the TCP connection, and for joining the cluster."""
NO_LIMIT = 1_000_000
"""A pool size that lets the cluster run one unit per core."""
CHECKPOINTS = "checkpoint"
"""Folder that is not copied between machines."""
PROBE = "import sys, ray; ray.init(address=sys.argv[1], log_to_driver=False)"
TOKEN_ERRORS = ("AuthenticationError", "Unauthenticated", "InvalidAuthToken")


class RayPool:
    """A pool that runs units on a Ray cluster."""

    def __init__(self, address: str, out: Path, size: int):
        """Connect to a cluster.

        Args:
            address: HOST:PORT of the cluster's head, as `ray start --head` prints it.
            out: the folder of the studies, on this machine.
            size: number of units to run at a time, at most one per core of the cluster.

        Raises:
            UsageError: the address is not HOST:PORT, or Ray is not installed.
            PlanspaceError: no cluster answers at the address, or it requires a token.
        """
        check_cluster(address)
        import ray

        self._ray, self._out = ray, out
        ray.init(
            address=address,
            log_to_driver=False,
            logging_level=logging.ERROR,
            runtime_env={"env_vars": WORKER_ENVIRONMENT},
        )
        cores = int(ray.cluster_resources().get("CPU", 1))
        self.size, self.cores = max(1, min(size, cores)), 1.0
        self._task = ray.remote(num_cpus=1, max_retries=RETRIES)(run_remotely)
        self._running: dict[Any, Unit] = {}

    def start(self, unit: Unit) -> None:
        """Send a unit to the cluster, with the files that it needs."""
        needed = {need.name: files_in(folder_of(need, self._out)) for need in unit.needs}
        self._running[self._task.remote(unit, needed, VERSIONS)] = unit

    def wait(self) -> Sequence[tuple[Unit, str | None]]:
        """Return the units that have ended, after writing their files to this machine."""
        ready, _ = self._ray.wait(list(self._running), timeout=REFRESH_S)
        return [self._fetch(task, self._running.pop(task)) for task in ready]

    def stop(self) -> None:
        """Cancel the running units and disconnect."""
        for task in self._running:
            self._ray.cancel(task, force=True)
        self._ray.shutdown()

    def _fetch(self, task: Any, unit: Unit) -> tuple[Unit, str | None]:
        try:
            result, files = self._ray.get(task)
        except Exception as error:  # any exception of the task is the unit's error
            cause = getattr(error, "cause", None)
            return unit, one_line(cause if isinstance(cause, Exception) else error)
        try:
            keep_result(unit, self._out, result)
        except PlanspaceError as error:
            return unit, one_line(error)
        rmtree(folder_of(unit, self._out), ignore_errors=True)  # an unfinished folder
        write_files(folder_of(unit, self._out), files)
        return unit, None


def ray_pool(address: str) -> Callable[[Path, int], RayPool]:
    """The `make_pool` argument of `run_study` for a cluster."""
    return partial(RayPool, address)


def check_cluster(address: str) -> None:
    """Check within ten seconds that a cluster accepts a connection.

    Raises:
        UsageError: the address is not HOST:PORT, or Ray is not installed.
        PlanspaceError: no cluster answers at the address, or it requires a token.
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        raise UsageError(f"`--ray` must be HOST:PORT, as `ray start --head` prints it, got {address!r}.")
    try:
        import ray  # noqa: F401
    except ImportError as error:
        raise UsageError(f"`--ray` needs the extra `ray`: {install_command('ray')}.") from error
    try:
        socket.create_connection((host, int(port)), timeout=CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise PlanspaceError(f"no Ray cluster answers at {address} ({error}).") from error
    try:  # in a separate process: Ray may kill a process that a cluster rejects
        probe = [sys.executable, "-c", PROBE, address]
        found = subprocess.run(probe, capture_output=True, timeout=PROBE_S, check=False)
        code, message = found.returncode, found.stderr.decode(errors="replace")
    except subprocess.TimeoutExpired as error:
        code, message = None, (error.stderr or b"").decode(errors="replace")
    if code == 0:
        return
    if any(sign in message for sign in TOKEN_ERRORS):
        raise PlanspaceError(
            f"the Ray cluster at {address} needs a token: set RAY_AUTH_MODE=token and RAY_AUTH_TOKEN "
            "(or RAY_AUTH_TOKEN_PATH)."
        )
    if code is None:
        raise PlanspaceError(f"the server at {address} does not answer like a Ray cluster.")
    last = message.strip().splitlines()[-1:] or ["it gave no reason"]
    raise PlanspaceError(f"the Ray cluster at {address} rejected the connection: {last[0]}")


# --- on the cluster -------------------------------------------------------------------------------------


def run_remotely(unit: Unit, needed: dict[str, Files], versions: dict[str, str]) -> tuple[UnitResult, Files]:
    """Run a unit in a temporary folder of the worker's machine. Part of the work may already be there.

    Args:
        unit: the unit.
        needed: the files of each unit that it needs, by the unit's name.
        versions: versions of the libraries on the machine that runs the study.

    Returns:
        The result, and the files of the unit's folder.

    Raises:
        PlanspaceError: the versions on this machine differ, or the unit failed.
    """
    if other := list(list_differences(versions, VERSIONS)):
        raise PlanspaceError(f"a worker of the cluster has different versions: {'; '.join(other)}.")
    scratch = make_folder(Path(tempfile.gettempdir()) / f"planspace-{getpass.getuser()}")
    with _own_core(scratch):
        out = make_folder(scratch / f"{unit.name}-{json_hash(versions)[:8]}")
        with lock_folder(out):
            for need in unit.needs:
                write_files(folder_of(need, out), needed[need.name])
            execute(unit, out)
            found = read_result(unit, out), files_in(folder_of(unit, out))
        rmtree(out, ignore_errors=True)
    return found


@contextmanager
def _own_core(scratch: Path) -> Iterator[None]:
    """Pin this process to a core that no other unit uses, because Ray counts one core per task."""
    cores = available_cores()
    with ExitStack() as held:
        for core in cores if hasattr(os, "sched_setaffinity") else ():
            try:
                held.enter_context(lock_folder(make_folder(scratch / f"core-{core}")))
            except PlanspaceError:  # used by another unit
                continue
            os.sched_setaffinity(0, {core})
            held.callback(os.sched_setaffinity, 0, cores)
            break
        yield


def files_in(folder: Path) -> Files:
    """Read the files of a unit's folder, except checkpoints."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    names = {path: path.relative_to(folder) for path in paths}
    return {str(name): read_bytes(path) for path, name in names.items() if CHECKPOINTS not in name.parts}


def write_files(folder: Path, files: Files) -> None:
    """Write a folder atomically. An existing folder is not changed."""
    if folder.exists():
        return
    make_folder(folder.parent)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".writing-") as temporary:
        whole = Path(temporary) / "folder"
        for name, data in files.items():
            make_folder((whole / name).parent)
            neighbours = folder.parent.iterdir() if name.startswith(f"{FOLDER}/") else ()
            write_or_link(whole / name, data, [other / name for other in neighbours])
        whole.rename(folder)
