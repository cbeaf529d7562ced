"""Runs a study: units in worker processes, each on cores of its own, each result committed as it comes."""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

import jax
import mujoco

import planspace
from planspace.cores import available_cores, one_thread_each
from planspace.errors import PlanspaceError
from planspace.progress import progress
from planspace.store import locked, make_folder, open_run, read_json, write_json
from planspace.study.execute import SCHEMA, execute, has_folder, is_done, read_result
from planspace.study.grid import Study
from planspace.study.unit import Unit

ATTEMPTS = 2
"""A unit that failed is tried again once, after the others."""
REFRESH_S = 1.0
PATIENCE_S, REMIND_S = 30.0, 5.0
"""So long do workers have to save what they are at when they are told to stop, and so often are they told."""
INTERRUPTED = 130


@dataclass
class Progress:
    """What has become of the units."""

    todo: list[Unit]
    """In the order in which they are to be run; those under way are not among them."""
    failed: dict[str, str] = field(default_factory=dict)
    """What was wrong with a unit, by its name."""
    attempts: dict[str, int] = field(default_factory=dict)

    def next(self, out: Path, running: Sequence[Unit]) -> Unit | None:
        """Takes the first unit that can be run now."""
        pending = {unit.name for unit in (*self.todo, *running)}
        for unit in self.todo:
            if any(need.name in self.failed for need in unit.needs):
                self.todo.remove(unit)
                self.failed[unit.name] = "what it needs has failed"
                return self.next(out, running)
            if not any(need.name in pending for need in unit.needs):
                self.todo.remove(unit)
                return unit
        return None

    def note(self, unit: Unit, error: str) -> None:
        """Takes down a failure; the unit is tried again at the end, or given up."""
        self.attempts[unit.name] = self.attempts.get(unit.name, 0) + 1
        if self.attempts[unit.name] < ATTEMPTS:
            self.todo.append(unit)
        else:
            self.failed[unit.name] = error


def open_results(out: Path) -> None:
    """Opens a folder of studies.

    Raises:
        PlanspaceError: it was made by other versions, or is something else.
    """
    versions = {"planspace": planspace.__version__, "mujoco": mujoco.__version__, "jax": jax.__version__}
    open_run(out, {"command": "study", "schema": SCHEMA, "versions": versions})


def units_to_run(study: Study, out: Path) -> list[Unit]:
    """What is not done, and what that needs and is not there (any more)."""
    todo: dict[str, Unit] = {}

    def visit(unit: Unit, folder_needed: bool) -> None:
        if unit.name in todo or (is_done(unit, out) and (has_folder(unit, out) or not folder_needed)):
            return
        for need in unit.needs:
            visit(need, True)  # pyright: ignore[reportArgumentType]
        todo[unit.name] = unit

    for arm in study.arms:
        for unit in arm.units:
            visit(unit, False)
    return list(todo.values())


def run_study(study: Study, out: Path, workers: int = 0) -> dict[str, str]:
    """Runs what is left of a study; the same call goes on where one was interrupted.

    Args:
        study: the study.
        out: the folder of the studies; units that another study has run are taken as they are.
        workers: processes; 0 takes one for each two cores, at least one for each core of a small machine.

    Returns:
        What was wrong with each unit that failed, by its name.

    Raises:
        PlanspaceError: the folder is of other versions or another kind, or another command is at work in it.
    """
    open_results(out)
    make_folder(out / "work")
    with locked(out):
        state = Progress(units_to_run(study, out))
        total = len(study.units)
        if state.todo:
            _run_all(state, study, out, total, min(workers or available_workers(), len(state.todo)))
    return state.failed


def available_workers() -> int:
    """Processes that do not get in each other's way: one a core."""
    return len(available_cores())


@dataclass
class _Worker:
    """A unit under way."""

    unit: Unit
    process: SpawnProcess
    slot: int
    began: float


def _run_all(state: Progress, study: Study, out: Path, total: int, workers: int) -> None:
    running: list[_Worker] = []
    slots = set(range(workers))
    pace = _Pace(study, out)
    with progress(f"study {study.name}", total, done=total - len(state.todo), unit="unit") as bar:
        try:
            while state.todo or running:
                while slots and (unit := state.next(out, [w.unit for w in running])) is not None:
                    running.append(_start(unit, out, slots.pop(), workers))
                if not running:
                    break
                wait([w.process.sentinel for w in running], timeout=REFRESH_S)
                for worker in [w for w in running if not w.process.is_alive()]:
                    running.remove(worker)
                    slots.add(worker.slot)
                    if worker.process.exitcode == 0:
                        bar.update()
                        pace.add(worker.unit, time.monotonic() - worker.began)
                    else:
                        state.note(worker.unit, _error_of(worker, out))
                left = pace.left(state.todo, running, workers)
                parts = [f"{len(running)} running", f"{len(state.failed)} failed", f"{left} left"]
                bar.set_postfix_str(", ".join(parts), refresh=sys.stderr.isatty())
        finally:
            _stop(running)


def _start(unit: Unit, out: Path, slot: int, workers: int) -> _Worker:
    context = multiprocessing.get_context("spawn")  # a fork would copy thread pools that no longer run
    process = context.Process(target=_work, args=(unit, out, slot, workers), name=unit.name)
    with one_thread_each():
        process.start()
    return _Worker(unit, process, slot, time.monotonic())


def _stop(running: Sequence[_Worker]) -> None:
    """Lets what is under way be saved."""
    deadline = time.monotonic() + PATIENCE_S
    while alive := [worker.process for worker in running if worker.process.is_alive()]:
        for process in alive:  # more than once: an interrupt can be lost in a callback of the interpreter
            process.terminate() if time.monotonic() < deadline else process.kill()
        wait([process.sentinel for process in alive], timeout=REMIND_S)


class _Pace:
    """How long units take, against what was guessed."""

    def __init__(self, study: Study, out: Path):
        self._guessed, self._taken = 0.0, 0.0
        for unit in study.units:
            if is_done(unit, out) and not (result := read_result(unit, out))["resumed"]:
                self.add(unit, result["seconds"])

    def add(self, unit: Unit, seconds: float) -> None:
        self._guessed += unit.cost
        self._taken += seconds

    def left(self, todo: Sequence[Unit], running: Sequence[_Worker], workers: int) -> str:
        factor = self._taken / self._guessed if self._guessed else 1.0
        now = time.monotonic()
        waiting = sum(unit.cost for unit in todo) * factor
        under_way = sum(max(w.unit.cost * factor - (now - w.began), 0.0) for w in running)
        minutes = (waiting + under_way) / workers / 60
        return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def _error_of(worker: _Worker, out: Path) -> str:
    code = worker.process.exitcode or 0
    if code < 0:
        return f"its process was killed by {signal.Signals(-code).name}"
    file = _error_file(worker.unit, out)
    return str(read_json(file)["error"]) if file.exists() else f"its process ended with {code}"


def _error_file(unit: Unit, out: Path) -> Path:
    return out / "work" / f"{unit.name}.error.json"


# --- in the worker --------------------------------------------------------------------------------------


def _work(unit: Unit, out: Path, slot: int, workers: int) -> None:
    """A worker's life: one unit."""
    os.setpgid(0, 0)  # Ctrl-C is the parent's to hear, who then says so
    signal.signal(signal.SIGTERM, _interrupt)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    cores = available_cores()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores[slot::workers] or cores)
    with open(out / "work" / f"{unit.name}.log", "a", buffering=1) as log, contextlib.redirect_stderr(log):
        try:
            execute(unit, out)
        except KeyboardInterrupt:
            sys.exit(INTERRUPTED)
        except Exception as error:
            traceback.print_exc()
            _write_error(unit, out, error)
            sys.exit(1)


def _write_error(unit: Unit, out: Path, error: Exception) -> None:
    text = " ".join(str(error).split())
    named = text if isinstance(error, PlanspaceError) else f"{type(error).__name__}: {text}"
    with contextlib.suppress(PlanspaceError):  # the disk may be what is wrong
        write_json(_error_file(unit, out), {"error": named})


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(INTERRUPTED)


def failures(failed: dict[str, str], study: Study) -> Iterator[str]:
    """A line for each unit that failed, with the arms it belongs to."""
    for name, error in failed.items():
        arms = [arm.name for arm in study.arms if any(unit.name == name for unit in arm.units)]
        yield f"{name} ({', '.join(arms) or 'needed by others'}): {error}"
