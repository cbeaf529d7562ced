"""A study on a Ray cluster: the same units as Ray Core tasks, folders carried as objects.

A task is given the files of what its unit needs and brings back the files the unit left, so the machines
share nothing but the cluster; all need planspace in the same version. A worker that dies is replaced by Ray;
on the machine it died on, the unit goes on from its last checkpoint.
"""

import getpass
import logging
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any

from planspace.errors import PlanspaceError, UsageError
from planspace.storage.files import make_folder, read_bytes, write_bytes
from planspace.storage.json_files import json_hash
from planspace.storage.runs import lock_folder
from planspace.storage.settings import list_differences
from planspace.study.execute import VERSIONS, execute, folder_of, keep_result, read_result
from planspace.study.pool import REFRESH_S, named
from planspace.study.results import UnitResult
from planspace.study.unit import Unit
from planspace.workers import WORKER_ENVIRONMENT, available_cores

Files = dict[str, bytes]

RETRIES = 3
"""So often does Ray start a task again whose worker has died."""
KNOCK_S, PROBE_S = 1.5, 6.0
"""A cluster must be reachable within the first, and let us in within the second."""
MOST = 1_000_000
"""As many units at a time as the cluster has cores."""
CHECKPOINTS = "checkpoint"
"""What is not brought back of a unit's folder."""
PROBE = "import sys, ray; ray.init(address=sys.argv[1], log_to_driver=False)"
NEEDS_TOKEN = ("AuthenticationError", "Unauthenticated", "InvalidAuthToken")


class RayPool:
    """Runs units on a cluster."""

    def __init__(self, address: str, out: Path, size: int):
        """Connects.

        Args:
            address: HOST:PORT of the cluster's head, as `ray start --head` prints it.
            out: the folder of the studies, here.
            size: how many units at a time; a cluster runs as many as it has cores, if that is fewer.

        Raises:
            UsageError: the address is none, or Ray is not installed.
            PlanspaceError: nothing answers there, or it asks for a token.
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
        self.size = max(1, min(size, cores))
        self._task = ray.remote(num_cpus=1, max_retries=RETRIES)(run_remotely)
        self._running: dict[Any, Unit] = {}

    def start(self, unit: Unit) -> None:
        """Sends a unit, with the files of what it needs."""
        needed = {need.name: files_in(folder_of(need, self._out)) for need in unit.needs}
        self._running[self._task.remote(unit, needed, VERSIONS)] = unit

    def wait(self) -> Sequence[tuple[Unit, str | None]]:
        """The units that have ended, their files laid down here."""
        ready, _ = self._ray.wait(list(self._running), timeout=REFRESH_S)
        return [self._fetch(task, self._running.pop(task)) for task in ready]

    def stop(self) -> None:
        """Leaves the cluster; what is under way there is ended."""
        for task in self._running:
            self._ray.cancel(task, force=True)
        self._ray.shutdown()

    def _fetch(self, task: Any, unit: Unit) -> tuple[Unit, str | None]:
        try:
            result, files = self._ray.get(task)
        except Exception as error:  # whatever went wrong there is that unit's error here
            cause = getattr(error, "cause", None)
            return unit, named(cause if isinstance(cause, Exception) else error)
        try:
            keep_result(unit, self._out, result)
        except PlanspaceError as error:
            return unit, named(error)
        rmtree(folder_of(unit, self._out), ignore_errors=True)  # what was begun here
        lay_down(folder_of(unit, self._out), files)
        return unit, None


def ray_pool(address: str) -> Any:
    """What `run_study` makes a pool with."""
    return partial(RayPool, address)


def check_cluster(address: str) -> None:
    """Sees within ten seconds whether a cluster answers and lets us in.

    Raises:
        UsageError: the address is no HOST:PORT, or Ray is not installed.
        PlanspaceError: nothing answers there, or it asks for a token.
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        raise UsageError(f"--ray takes HOST:PORT, as `ray start --head` prints it, got {address!r}.")
    try:
        import ray  # noqa: F401
    except ImportError as error:
        raise UsageError("--ray needs the extra `ray`: pip install 'planspace[ray]'.") from error
    try:
        socket.create_connection((host, int(port)), timeout=KNOCK_S).close()
    except (OSError, OverflowError) as error:
        raise PlanspaceError(f"no Ray cluster answers at {address} ({error}).") from error
    try:  # in a process of its own: Ray may end the one that a cluster turns away
        probe = [sys.executable, "-c", PROBE, address]
        found = subprocess.run(probe, capture_output=True, timeout=PROBE_S, check=False)
        code, said = found.returncode, found.stderr.decode(errors="replace")
    except subprocess.TimeoutExpired as error:
        code, said = None, (error.stderr or b"").decode(errors="replace")
    if code == 0:
        return
    if any(sign in said for sign in NEEDS_TOKEN):
        raise PlanspaceError(
            f"the Ray cluster at {address} needs a token: set RAY_AUTH_MODE=token and RAY_AUTH_TOKEN "
            "(or RAY_AUTH_TOKEN_PATH)."
        )
    if code is None:
        raise PlanspaceError(f"what listens at {address} does not answer as a Ray cluster does.")
    last = said.strip().splitlines()[-1:] or ["it gave no reason"]
    raise PlanspaceError(f"the Ray cluster at {address} turned us away: {last[0]}")


# --- on the cluster -------------------------------------------------------------------------------------


def run_remotely(unit: Unit, needed: dict[str, Files], versions: dict[str, str]) -> tuple[UnitResult, Files]:
    """A task: runs a unit in a folder of this machine, where a worker that died before has left what it had.

    Raises:
        PlanspaceError: a library is another version here, or the unit failed.
    """
    if other := list(list_differences(versions, VERSIONS)):
        raise PlanspaceError(f"a worker has other versions: {'; '.join(other)}.")
    scratch = make_folder(Path(tempfile.gettempdir()) / f"planspace-{getpass.getuser()}")
    with _own_core(scratch):
        out = make_folder(scratch / f"{unit.name}-{json_hash(versions)[:8]}")
        with lock_folder(out):
            for need in unit.needs:
                lay_down(folder_of(need, out), needed[need.name])
            execute(unit, out)
            found = read_result(unit, out), files_in(folder_of(unit, out))
        rmtree(out, ignore_errors=True)
    return found


@contextmanager
def _own_core(scratch: Path) -> Iterator[None]:
    """Keeps this process to a core that no other task of ours is on, as Ray has been told it would."""
    cores = available_cores()
    with ExitStack() as held:
        for core in cores if hasattr(os, "sched_setaffinity") else ():
            try:
                held.enter_context(lock_folder(make_folder(scratch / f"core-{core}")))
            except PlanspaceError:  # another task is on it
                continue
            os.sched_setaffinity(0, {core})
            held.callback(os.sched_setaffinity, 0, cores)
            break
        yield


def files_in(folder: Path) -> Files:
    """The files of a unit's folder by their paths in it, without checkpoints."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    names = {path: path.relative_to(folder) for path in paths}
    return {str(name): read_bytes(path) for path, name in names.items() if CHECKPOINTS not in name.parts}


def lay_down(folder: Path, files: Files) -> None:
    """Makes a folder of files, all at once; one that is there already is left alone."""
    if folder.exists():
        return
    make_folder(folder.parent)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".writing-") as temporary:
        whole = Path(temporary) / "folder"
        for name, data in files.items():
            make_folder((whole / name).parent)
            write_bytes(whole / name, data)
        whole.rename(folder)
