import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.study.cluster import check_cluster, files_in, ray_pool, write_files
from planspace.study.execute import is_done
from planspace.study.run import run_study

from ..tiny_study import FIT, PLANS, TINY, what_was_found

LOCAL = "127.0.0.1"
TASK_TITLE = "ray::run_remotely"


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind((LOCAL, 0))
        return int(listener.getsockname()[1])


@contextlib.contextmanager
def ray_cluster(**environment: str) -> Iterator[str]:
    """Start a cluster on this machine, and stop only this cluster."""
    port = free_port()
    start = [sys.executable, "-m", "ray.scripts.scripts", "start", "--head", "--block", f"--port={port}"]
    flags = [f"--node-ip-address={LOCAL}", "--num-cpus=2", "--include-dashboard=false"]
    with subprocess.Popen(
        [*start, *flags, "--disable-usage-stats"],
        env={**os.environ, "RAY_TMPDIR": "/tmp", **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as cluster:
        try:
            assert cluster.stdout is not None
            assert any("Ray runtime started" in line for line in cluster.stdout)
            yield f"{LOCAL}:{port}"
        finally:
            os.killpg(cluster.pid, signal.SIGKILL)


def workers() -> list[int]:
    rows = subprocess.run(["ps", "-eo", "pid,args"], capture_output=True, text=True, check=True).stdout
    return [int(row.split()[0]) for row in rows.splitlines() if TASK_TITLE in row]


@pytest.mark.ray
@pytest.mark.nightly
def test_a_cluster_gives_the_same_results_if_a_worker_is_killed(finished: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray")
    killed: list[int] = []

    def kill_one() -> None:
        deadline = time.monotonic() + 120
        while not killed and time.monotonic() < deadline:
            time.sleep(0.2)
            for pid in workers()[:1]:
                time.sleep(1.0)  # let it start working
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)

    out = tmp_path / "out"
    with ray_cluster() as address:
        killer = threading.Thread(target=kill_one)
        killer.start()
        failed = run_study(TINY, out, 2, ray_pool(address))
        killer.join()
    assert failed == {} and len(killed) == 1
    assert what_was_found(TINY, out) == what_was_found(TINY, finished)
    assert (out / "work" / FIT.name / "embedding.json").exists()  # folders are copied back
    assert (out / "work" / PLANS.name / "manifest.json").exists()
    assert all(is_done(unit, out) for unit in TINY.units)


@pytest.mark.ray
@pytest.mark.nightly
def test_a_missing_token_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    with ray_cluster(RAY_AUTH_MODE="token", RAY_AUTH_TOKEN="a" * 64) as address:
        monkeypatch.setenv("RAY_AUTH_MODE", "token")
        monkeypatch.setenv("RAY_AUTH_TOKEN", "b" * 64)
        start = time.monotonic()
        with pytest.raises(PlanspaceError, match="needs a token: set RAY_AUTH_MODE=token and RAY_AUTH"):
            check_cluster(address)
        assert time.monotonic() - start < 20  # ten seconds on an idle machine
        monkeypatch.setenv("RAY_AUTH_TOKEN", "a" * 64)
        check_cluster(address)


@pytest.mark.ray
def test_an_address_without_a_server_is_reported() -> None:
    pytest.importorskip("ray")
    address = f"{LOCAL}:{free_port()}"
    with pytest.raises(PlanspaceError, match=f"no Ray cluster answers at {address}"):
        check_cluster(address)


@pytest.mark.ray
def test_a_server_that_is_not_ray_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    monkeypatch.setattr("planspace.study.cluster.PROBE_S", 3.0)
    with socket.socket() as listener:
        listener.bind((LOCAL, 0))
        listener.listen()
        address = f"{LOCAL}:{listener.getsockname()[1]}"
        with pytest.raises(
            PlanspaceError, match=f"{address}.* (does not answer like|rejected the connection)"
        ):
            check_cluster(address)


@pytest.mark.parametrize("address", ["", "auto", "host", "host:port", "host:-1"])
def test_an_address_must_be_host_and_port(address: str) -> None:
    with pytest.raises(UsageError, match="`--ray` must be HOST:PORT"):
        check_cluster(address)


def test_folders_are_copied_without_checkpoints(tmp_path: Path) -> None:
    folder = tmp_path / "unit"
    for name in ("a.json", "embedding/b.bin", "checkpoint/state"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(name.encode())
    files = files_in(folder)
    assert set(files) == {"a.json", "embedding/b.bin"}
    write_files(tmp_path / "work" / "copy", files)
    assert files_in(tmp_path / "work" / "copy") == files
    write_files(tmp_path / "work" / "copy", {"other": b""})  # an existing folder is not changed
    assert files_in(tmp_path / "work" / "copy") == files
    assert [path.name for path in (tmp_path / "work").iterdir()] == ["copy"]
