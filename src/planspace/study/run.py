"""Run a study: run its missing units in a pool, and save each result when it is ready."""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from planspace.progress import progress
from planspace.storage.files import TEMPORARY_PREFIX, make_folder
from planspace.storage.runs import lock_folder, open_run
from planspace.study.design import Study
from planspace.study.eta import Timings, time_left
from planspace.study.execute import SCHEMA, VERSIONS, has_folder, is_done, read_result
from planspace.study.pool import LocalPool, Pool
from planspace.study.unit import Unit
from planspace.workers import count_cores

ATTEMPTS = 2
"""How often a unit is tried. A failed unit is tried again after the others."""


def open_results(out: Path) -> None:
    """Open a folder of studies, or make it.

    Raises:
        PlanspaceError: the folder was made with other versions, or is not a folder of studies.
    """
    open_run(out, {"command": "study", "schema": SCHEMA, "versions": VERSIONS})


def units_to_run(study: Study, out: Path) -> list[Unit]:
    """The units without a result, and the units that they need and whose folders are missing."""
    todo: dict[str, Unit] = {}

    def visit(unit: Unit, folder_needed: bool) -> None:
        if unit.name in todo or (is_done(unit, out) and (has_folder(unit, out) or not folder_needed)):
            return
        for need in unit.needs:
            visit(need, True)
        todo[unit.name] = unit

    for unit in study.units:
        visit(unit, False)
    return list(todo.values())


def run_study(
    study: Study, out: Path, workers: int = 0, make_pool: Callable[[Path, int], Pool] = LocalPool
) -> dict[str, str]:
    """Run the missing units of a study. The same call resumes an interrupted one.

    Args:
        study: the study.
        out: the folder of the studies. Units that another study has run are reused.
        workers: number of units to run at a time; 0 runs one per core.
        make_pool: makes the pool that runs units, from the folder and the number of units at a time.

    Returns:
        The error of each failed unit, by the unit's name.

    Raises:
        PlanspaceError: the folder was made with other versions, is not a folder of studies, or is in use by
            another process.
    """
    with lock_folder(out):
        open_results(out)
        make_folder(out / "work")
        for partial in (out / "units").glob(f"{TEMPORARY_PREFIX}*"):  # left by a process killed while writing
            partial.unlink()
        state = _State(units_to_run(study, out))
        if state.todo:
            pool = make_pool(out, min(workers or count_cores(), len(state.todo)))
            try:
                _run_all(state, study, out, pool)
            finally:
                pool.stop()
    return state.failed


def failures(failed: dict[str, str], study: Study) -> Iterator[str]:
    """One line per failed unit, with its arms."""
    for name, error in failed.items():
        arms = [arm.name for arm in study.arms if any(unit.name == name for unit in arm.units)]
        yield f"{name} ({', '.join(arms) or 'needed by other units'}): {error}"


@dataclass
class _State:
    """The state of all units."""

    todo: list[Unit]
    """Waiting units, in the order in which they will run."""
    running: dict[str, tuple[Unit, float]] = field(default_factory=dict)
    """Running units by name, with their start times."""
    failed: dict[str, str] = field(default_factory=dict)
    """Errors of the units that failed in every attempt, by name."""
    attempts: dict[str, int] = field(default_factory=dict)

    def next(self) -> Unit | None:
        """Take the first unit that can run now. Units that need a failed unit fail too."""
        pending = {unit.name for unit in self.todo} | self.running.keys()
        for unit in list(self.todo):
            if any(need.name in self.failed for need in unit.needs):
                self.todo.remove(unit)
                self.failed[unit.name] = "a unit that it needs failed"
            elif not any(need.name in pending for need in unit.needs):
                self.todo.remove(unit)
                self.running[unit.name] = unit, time.monotonic()
                return unit
        return None

    def ended(self, unit: Unit, error: str | None) -> None:
        """Record how a unit ended."""
        del self.running[unit.name]
        if error is not None:
            self.attempts[unit.name] = self.attempts.get(unit.name, 0) + 1
            if self.attempts[unit.name] < ATTEMPTS:
                self.todo.append(unit)
            else:
                self.failed[unit.name] = error


def _run_all(state: _State, study: Study, out: Path, pool: Pool) -> None:
    results = {unit.name: read_result(unit, out) for unit in study.units if is_done(unit, out)}
    timings = Timings.of(study.units, results)
    done = sum(unit.name in results and unit not in state.todo for unit in study.units)
    with progress(f"study {study.name}", len(study.units), done=done, unit="unit", remaining=False) as bar:
        refresh = True  # say at once how long it takes
        while state.todo or state.running:
            left = _time_left(state, timings, pool)
            while len(state.running) < pool.size and (unit := state.next()) is not None:
                pool.start(unit)
            if not state.running:
                break
            counts = f"{len(state.running)} running, {len(state.failed)} failed"
            bar.set_postfix_str(f"{counts}, {left} left", refresh=refresh)
            for unit, error in pool.wait():
                state.ended(unit, error)
                if error is None:
                    bar.update()
                    result = read_result(unit, out)
                    if unit.name not in results and not result.resumed:
                        timings.add(unit, result.core_seconds)
            refresh = sys.stderr.isatty()


def _time_left(state: _State, timings: Timings, pool: Pool) -> str:
    """Estimate the time until every unit is finished."""
    now = time.monotonic()
    running = {
        unit.name: max(timings.estimate(unit) / pool.cores - (now - start), 0.0)
        for unit, start in state.running.values()
    }
    minutes = time_left(state.todo, running, timings, pool.size, pool.cores) / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"
