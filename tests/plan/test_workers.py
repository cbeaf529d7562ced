"""Calls in real worker processes, and planning that is interrupted while they work."""

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import planspace as ps
from planspace.errors import UsageError
from planspace.storage.runs import LOCK
from planspace.workers import ORPHAN_EXIT_CODE, WorkerDied, WorkerPool

from .test_own_planner import MODEL, PROBLEM
from .waiting import Waiting

ROOT = Path(__file__).parents[2]
LIMIT_S = 60
needs_posix = pytest.mark.skipif(os.name != "posix", reason="POSIX signals")


@pytest.fixture
def problem(tmp_path: Path) -> str:
    (tmp_path / "mass.xml").write_text(MODEL)
    (tmp_path / "mass.yaml").write_text(PROBLEM)
    return str(tmp_path / "mass.yaml")


def wait_until(condition: Callable[[], object], process: subprocess.Popen | None = None) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.02)


def is_running(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


def start(command: list[str], **environment: str) -> subprocess.Popen:
    """A process in which Ctrl-C is not ignored, as it would be in the background of a shell."""
    heed = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    return subprocess.Popen(
        [sys.executable, "-c", heed + "from planspace.cli import main; sys.exit(main())", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment,
        start_new_session=True,
    )


# --- calls --------------------------------------------------------------------------------------------


def test_calls_return_raise_and_print() -> None:
    with WorkerPool(2, {"PLANSPACE_TEST": "set"}) as pool:
        calls = [
            pool.submit(os.getenv, "PLANSPACE_TEST"),
            pool.submit(print, "text"),
            pool.submit(int, "x"),
        ]
        assert [calls[0].result(LIMIT_S), calls[1].result(LIMIT_S)] == ["set", None]
        with pytest.raises(ValueError, match="invalid literal") as raised:
            calls[2].result(LIMIT_S)
        assert "In a worker process:" in raised.value.__notes__[0]
        assert "PLANSPACE_TEST" not in os.environ


class TwoArguments(Exception):
    """An exception that pickle cannot read again."""

    def __init__(self, one: int, two: int):
        super().__init__(f"{one} and {two}")


def raise_unreadable() -> None:
    raise TwoArguments(1, 2)


def test_an_exception_that_cannot_be_sent_arrives_as_text() -> None:
    with WorkerPool(1) as pool, pytest.raises(RuntimeError, match="TwoArguments: 1 and 2"):
        pool.submit(raise_unreadable).result(LIMIT_S)


def test_a_worker_that_dies_fails_its_call_and_those_after_it() -> None:
    with WorkerPool(1) as pool:
        crashed, late = pool.submit(ctypes.string_at, 0), pool.submit(os.getpid)
        for future in (crashed, late):
            with pytest.raises(WorkerDied, match=f"exit code {-signal.SIGSEGV}"):
                future.result(LIMIT_S)


def start_sleep() -> int:
    return subprocess.Popen(["sleep", "1000"]).pid


@needs_posix
def test_the_end_of_the_block_kills_a_worker_and_what_it_started() -> None:
    with WorkerPool(1) as pool:
        pids = [pool.submit(call).result(LIMIT_S) for call in (os.getpid, start_sleep)]
        assert all(map(is_running, pids))
        pool.submit(time.sleep, 1000)
    wait_until(lambda: not any(map(is_running, pids)))


@needs_posix
def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    code = """
import os, time
from planspace.workers import WorkerPool
with WorkerPool(2) as pool:
    print(*[pool.submit(os.getpid).result() for _ in range(8)], flush=True)
    [pool.submit(time.sleep, 1000) for _ in range(4)]
    time.sleep(1000)
"""
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    workers = {int(pid) for pid in parent.stdout.readline().split()}
    assert all(map(is_running, workers))
    parent.kill()
    parent.communicate()
    wait_until(lambda: not any(map(is_running, workers)))
    assert ORPHAN_EXIT_CODE == 130


# --- planning -----------------------------------------------------------------------------------------


@pytest.mark.slow
@needs_posix
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.nightly)]
)
def test_an_interrupt_keeps_finished_plans_and_the_same_command_continues(
    problem: str, tmp_path: Path, number: int, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WAITING_FOLDER", str(tmp_path))
    expected = ps.plan_demos(problem, 6, planner=Waiting(), workers=1, verbose=False)
    starts = [float(x) for x in expected.states[expected.offsets[:-1], 0]]
    for file in tmp_path.glob("found *"):
        file.unlink()
    (tmp_path / "own.py").write_text("from tests.plan.waiting import Waiting\nWAITING = Waiting()\n")
    planner = ["--planner", f"{tmp_path}/own.py:WAITING"]
    command = ["plan", problem, *planner, "--num", "6", "--workers", "2", "--out", str(tmp_path / "demos")]
    process = start(command, WAIT_AT=repr(starts[3]))
    wait_until(lambda: len(list(tmp_path.glob("found *"))) == 5, process)
    time.sleep(1)  # for the polish after the search
    process.send_signal(number)
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == code, err
    assert err.endswith("\ninterrupted; the same command continues from here.\n") and "Traceback" not in err
    assert len(ps.load_demos(tmp_path / "demos")) == 3  # the plans before the one that did not end
    resumed = start(command)
    assert (resumed.communicate(timeout=LIMIT_S), resumed.returncode)[1] == 0
    assert ps.load_demos(tmp_path / "demos").hash == expected.hash


def children(pid: int) -> list[int]:
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True)
    return [int(child) for child in found.stdout.split()]


@pytest.mark.slow
@needs_posix
@pytest.mark.parametrize("gaps", [[0.0], [0.1], [0.7], [0.6, 0.6]])
def test_repeated_interrupts_of_a_long_plan_never_hang(tmp_path: Path, gaps: list[float]) -> None:
    command = ["plan", "acrobot", "--num", "40", "--workers", "2", "--out", str(tmp_path / "demos")]
    process = start(command)
    wait_until(lambda: len(children(process.pid)) == 2, process)
    workers = children(process.pid)
    time.sleep(2)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    for gap in gaps:
        time.sleep(gap)
        os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode in (130, -signal.SIGINT), err  # a shell shows both as 130
    assert "Traceback" not in err
    wait_until(lambda: not any(map(is_running, workers)))


@pytest.mark.slow
@needs_posix
def test_a_second_signal_ends_a_command_that_does_not_stop() -> None:
    code = """
import signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from planspace.cli.interrupts import interruptible
with interruptible(whole_process=True):
    try:
        print("started", flush=True)
        time.sleep(1000)
    finally:
        print("stopping", flush=True)
        time.sleep(1000)
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "stopping\n"
    time.sleep(0.7)
    process.send_signal(signal.SIGTERM)
    assert (process.communicate(timeout=LIMIT_S)[1], process.returncode) == ("", 143)


@pytest.mark.slow
@needs_posix
@pytest.mark.ompl
def test_an_interrupt_ends_the_process_of_ompl(tmp_path: Path) -> None:
    pytest.importorskip("ompl")
    command = ["plan", "acrobot", "--planner", "ompl-sst", "--seconds", "500", "--num", "4"]
    process = start([*command, "--workers", "2", "--out", str(tmp_path / "demos")])
    searches: list[int] = []
    deadline = time.monotonic() + LIMIT_S
    while len(searches) < 2 and time.monotonic() < deadline:
        searches = [search for worker in children(process.pid) for search in children(worker)]
        time.sleep(0.1)
    time.sleep(2)
    process.send_signal(signal.SIGINT)
    assert (process.communicate(timeout=LIMIT_S), process.returncode)[1] == 130
    assert len(searches) == 2
    wait_until(lambda: not any(map(is_running, searches)))


SCRIPT = """
import planspace as ps
from tests.plan.bang_bang import BangBang
SIGN = 1.0
class Own(BangBang):
    def plan(self, query, rng):
        assert SIGN == 1.0
        return BangBang.plan(self, query, rng)

print(ps.plan_demos({problem!r}, 2, planner=Own(), workers=2, verbose=False).hash)
own = Own()
print(ps.plan_demos({problem!r}, 2, planner=lambda query, rng: own.plan(query, rng), workers=2).hash)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "how", ["script", *(pytest.param(how, marks=pytest.mark.nightly) for how in ("standard input", "prompt"))]
)
def test_a_script_without_a_guard_and_a_prompt_can_plan(problem: str, tmp_path: Path, how: str) -> None:
    script, text = tmp_path / "script.py", SCRIPT.format(problem=problem)
    script.write_text(text)
    given = {"script": [str(script)], "standard input": ["-"], "prompt": ["-i", "-q"]}[how]
    done = subprocess.run(
        [sys.executable, *given],
        input=text,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
    )
    first, second = [line for line in done.stdout.splitlines() if len(line) == 64] or (done.stderr, "")
    assert first == second


@pytest.mark.slow
def test_a_planner_that_crashes_its_worker_is_named(problem: str, tmp_path: Path) -> None:
    class Crashing(Waiting):
        def plan(self, query: object, rng: object) -> None:
            os.abort()

    with pytest.raises(ps.PlanspaceError, match=r"ended unexpectedly \(exit code -6\) while planning"):
        ps.plan_demos(problem, 3, planner=Crashing(), workers=2, verbose=False)


@pytest.mark.slow
@needs_posix
def test_a_second_command_on_the_same_folder_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "demos"
    lock = out / LOCK
    command = ["plan", "acrobot", "--num", "40", "--workers", "1", "--out", str(out)]
    first = start(command)
    wait_until(lambda: lock.exists() and lock.read_text() == str(first.pid), first)
    second = start(command)
    _, err = second.communicate(timeout=LIMIT_S)
    wanted = f"planspace: {out} is in use by another planspace process (pid {first.pid}); wait for it, or "
    assert (second.returncode, err) == (1, f"{wanted}choose another --out.\n")
    first.kill()
    first.communicate()
    third = start(command)  # the kill released the lock
    wait_until(lambda: lock.read_text() == str(third.pid), third)
    third.send_signal(signal.SIGINT)
    third.communicate(timeout=LIMIT_S)
    assert third.returncode == 130 and not list(out.iterdir())


def test_a_planner_that_cannot_be_sent_is_refused(problem: str, tmp_path: Path) -> None:
    class Locked(Waiting):
        lock = threading.Lock()

    with pytest.raises(UsageError, match="cannot be sent to worker processes: .* workers=0"):
        ps.plan_demos(problem, 1, planner=Locked(), out=tmp_path / "demos")
    assert not (tmp_path / "demos").exists()
