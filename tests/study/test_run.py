import contextlib
import json
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from planspace.demos.load import load_demos
from planspace.errors import PlanspaceError
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.study import run as module
from planspace.study.design import Arm
from planspace.study.execute import folder_of, is_done, read_result, result_file
from planspace.study.pool import LocalPool
from planspace.study.report import write_report
from planspace.study.run import failures, open_results, run_study, units_to_run
from planspace.study.summary import read_findings, summarise
from planspace.study.tables import as_text
from planspace.study.unit import Unit
from planspace.tasks.problem_file import load_problem
from planspace.workers import WORKER_ENVIRONMENT, count_cores

from ..tiny_study import FIT, PLANS, RAW, TINY, WITH_Z, policy, run_alone, what_was_found

pytestmark = pytest.mark.slow  # every test here runs units of a study
KILLS = 3
PLANNER = PlanConfig.for_problem(load_problem(PLANS.problem), **dict(PLANS.settings))


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "out")


def test_every_unit_writes_its_result(finished: Path) -> None:
    found = what_was_found(TINY, finished)
    assert found[PLANS.name].count == 12 and found[PLANS.name].reached == 1.0
    fit = found[FIT.name]
    assert fit.seed in (0, 1) and len(fit.bound[0]) == 2 and len(fit.paths[0][0]) == 3
    for arm in TINY.arms:
        for unit in arm.units:
            result = found[unit.name]
            assert result.seeds == (unit.config.seed,) and result.steps == (4000, 8000)
            assert all(0 < row[0] <= 100 for row in result.returns)
            assert len(result.film.poses) > 1
    kinds = {file.name.split("-")[0] for file in (finished / "units").iterdir()}
    assert kinds == {"plans", "fit", "policies"}


@pytest.mark.nightly
def test_finished_units_are_not_run_again_even_without_their_folders(copied: Path) -> None:
    shutil.rmtree(copied / "work")  # as if only the results were copied to this machine
    assert units_to_run(TINY, copied) == []
    more = replace(TINY, arms=(replace(WITH_Z, units=(*WITH_Z.units, policy(2, z=True))),))
    # the new unit needs the folders of the embedding and of its demonstrations; both have results
    assert units_to_run(more, copied) == [PLANS, FIT, policy(2, z=True)]
    before = {unit.name: read_result(unit, copied).found for unit in (PLANS, FIT)}
    assert run_study(more, copied, workers=1) == {}
    assert {unit.name: read_result(unit, copied).found for unit in (PLANS, FIT)} == before
    assert is_done(policy(2, z=True), copied)


@pytest.mark.nightly
def test_an_unfinished_folder_is_completed(copied: Path) -> None:
    shutil.rmtree(copied / "work")
    more = replace(TINY, arms=(replace(WITH_Z, units=(policy(2, z=True),)),))
    partial = replace(PLANS, num=10)  # of twelve, as after a kill
    plan_into(load_problem(PLANS.problem), folder_of(PLANS, copied), num=partial.num, seed=0, config=PLANNER)
    assert units_to_run(more, copied) == [PLANS, FIT, policy(2, z=True)]
    run_study(more, copied, workers=1)
    assert len(load_demos(folder_of(PLANS, copied))) == 12
    assert units_to_run(replace(more, arms=(replace(WITH_Z, units=(policy(3, z=True),)),)), copied) == [
        policy(3, z=True)
    ]


def test_results_do_not_depend_on_the_number_of_workers(finished: Path, tmp_path: Path) -> None:
    single = replace(TINY, arms=(replace(RAW, units=(policy(0),)),))
    run_study(single, tmp_path / "out", workers=1)  # uses all cores; a worker of `finished` uses one
    expected = read_result(policy(0), finished).found
    assert read_result(policy(0), tmp_path / "out").found == expected


@pytest.mark.skipif("OPENBLAS_CORETYPE" not in WORKER_ENVIRONMENT, reason="this CPU has no such kernels")
def test_results_do_not_depend_on_the_kernels_of_linear_algebra(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # every x86-64 CPU has these kernels; they sum in another order
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")
    open_results(tmp_path)
    (tmp_path / "work").mkdir()
    run_alone(PLANS, tmp_path)
    assert read_result(PLANS, tmp_path).found == read_result(PLANS, finished).found


def test_added_seeds_are_merged_with_the_first_ones(copied: Path) -> None:
    more = replace(TINY, arms=(replace(RAW, units=(*RAW.units, policy(2))),))
    assert units_to_run(more, copied) == [policy(2)]
    run_study(more, copied, workers=1)
    scores = read_findings(more, copied).scores[RAW.name]
    assert scores.seeds == (0, 1, 2)


@pytest.mark.nightly
def test_a_failing_unit_is_tried_twice_and_reported_and_the_others_run(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = replace(PLANS, num=2)  # too few to split
    bad = replace(FIT, plans=few)
    broken = Arm("balance", "broken", (replace(policy(0, z=True), fits=(bad,)),))
    study = replace(TINY, arms=(broken, replace(RAW, units=(policy(3),))))
    failed = run_study(study, copied, workers=1)
    assert set(failed) == {bad.name, broken.units[0].name}
    assert failed[broken.units[0].name] == "a unit that it needs failed"
    lines = list(failures(failed, study))
    assert any("balance/broken" in line for line in lines)
    assert is_done(policy(3), copied) and is_done(few, copied)
    log = (copied / "work" / f"{bad.name}.log").read_text()
    assert log.count("Traceback (most recent call last)") == module.ATTEMPTS
    assert not is_done(bad, copied)


class DeadlyPool(LocalPool):
    """A pool that kills its first workers."""

    def __init__(self, out: Path, size: int, kills: int):
        super().__init__(out, size)
        self.kills, self.started = kills, []

    def start(self, unit: Unit) -> None:
        super().start(unit)
        self.started.append(unit)
        if len(self.started) <= self.kills:
            self._running[-1].worker.close()


ONE = replace(TINY, arms=(replace(RAW, units=(policy(0),)),))


def test_a_worker_that_is_killed_is_replaced(tmp_path: Path) -> None:
    pools: list[DeadlyPool] = []

    def make_pool(out: Path, size: int) -> DeadlyPool:
        pools.append(DeadlyPool(out, size, kills=1))
        return pools[0]

    assert run_study(ONE, tmp_path / "out", workers=1, make_pool=make_pool) == {}
    assert pools[0].started == [policy(0), policy(0)]


def test_a_worker_killed_in_every_attempt_is_reported(tmp_path: Path) -> None:
    failed = run_study(ONE, tmp_path / "out", 1, lambda out, size: DeadlyPool(out, size, kills=2))
    assert failed == {policy(0).name: "its process was killed by SIGKILL"}


def test_two_commands_cannot_use_one_folder(copied: Path) -> None:
    from planspace.storage.runs import lock_folder

    with lock_folder(copied), pytest.raises(PlanspaceError, match="is in use by another planspace process"):
        run_study(TINY, copied)
    left_behind = copied / "units" / ".writing-x.json-123"
    left_behind.touch()
    assert run_study(TINY, copied) == {}
    assert not left_behind.exists()


@pytest.mark.nightly
def test_a_folder_made_again_must_match_its_result(copied: Path) -> None:
    shutil.rmtree(copied / "work")
    file = result_file(PLANS, copied)
    result = read_sealed(file)
    result["found"]["hash"] = "of another machine"
    write_sealed(file, result)
    more = replace(TINY, arms=(replace(WITH_Z, units=(policy(2, z=True),)),))
    failed = run_study(more, copied, workers=1)
    assert "was run again and gave a different result" in failed[PLANS.name]
    assert not is_done(policy(2, z=True), copied)
    assert read_result(PLANS, copied).found.hash == "of another machine"


def test_a_folder_of_other_versions_is_rejected(copied: Path) -> None:
    config = json.loads((copied / "config.json").read_text())
    config["versions"]["planspace"] = "0.0.1"
    (copied / "config.json").write_text(json.dumps(config))
    with pytest.raises(PlanspaceError, match=r"other settings: versions\.planspace was '0\.0\.1', now"):
        open_results(copied)


def test_a_damaged_result_is_reported_by_file_name(copied: Path) -> None:
    file = copied / "units" / f"{policy(0).name}.json"
    file.write_text(file.read_text().replace('"seeds": [0]', '"seeds": [7]'))
    with pytest.raises(PlanspaceError, match=f"{file.name} was altered or damaged: it does not"):
        read_findings(TINY, copied)


def test_tables_need_only_the_results(copied: Path) -> None:
    shutil.rmtree(copied / "work")
    summary = summarise(read_findings(TINY, copied))
    assert (summary.units_done, summary.units_all) == (6, 6)
    rows = {row.arm: row for row in summary.panels["balance"]}
    assert list(rows) == ["raw", "raw + z"]
    assert rows["raw"].seeds == 2 and rows["raw"].improvement is None
    assert rows["raw"].worst <= rows["raw"].mean <= rows["raw"].best
    assert summary.claims[0].verdict == "cannot tell"  # two seeds
    assert summary.embeddings[0].demos == 12 and summary.over_tasks == []  # one task
    assert summary.time.timed_units == 6
    assert "6 of 6 units" in as_text(summary) and "z helps" in as_text(summary)


def test_a_pool_has_at_most_one_worker_per_core(tmp_path: Path) -> None:
    assert LocalPool(tmp_path, 10_000).size == count_cores()


def test_the_report_of_an_unfinished_study(copied: Path) -> None:
    for unit in WITH_Z.units:
        (copied / "units" / f"{unit.name}.json").unlink()
    summary, page = write_report(read_findings(TINY, copied), copied)
    assert summary.claims[0].verdict == "not run yet"
    assert [row.arm for row in summary.panels["balance"]] == ["raw"]
    assert "4 of 6 units are done" in page.read_text()
    for unit in RAW.units:
        (copied / "units" / f"{unit.name}.json").unlink()
    with pytest.raises(PlanspaceError, match="no arm of study tiny has been run in"):
        write_report(read_findings(TINY, copied), copied)


SCRIPT = """
import signal
import sys
from pathlib import Path
sys.path.insert(0, {root!r})
from planspace.study.run import run_study
from tests.tiny_study import TINY

signal.signal(signal.SIGINT, signal.default_int_handler)  # background processes ignore it by default
run_study(TINY, Path({out!r}), workers=2)  # without a `__main__` guard
"""


def command(tmp_path: Path, out: Path) -> list[str]:
    script = tmp_path / "study.py"
    script.write_text(SCRIPT.format(root=str(Path(__file__).parents[2]), out=str(out)))
    return [sys.executable, str(script)]


def modification_times(out: Path) -> dict[Path, int]:
    """Modification time of every file in a folder."""
    found = {}
    for path in out.rglob("*"):
        with contextlib.suppress(FileNotFoundError):  # renamed in the meantime
            found[path] = path.stat().st_mtime_ns
    return found


@pytest.mark.nightly
def test_a_study_that_is_killed_repeatedly_ends_with_the_same_results(finished: Path, tmp_path: Path) -> None:
    out, rng = tmp_path / "out", random.Random(0)
    for _ in range(KILLS):
        process, before = (
            subprocess.Popen(command(tmp_path, out), stderr=subprocess.DEVNULL),
            modification_times(out),
        )
        while process.poll() is None and modification_times(out) == before:  # until it writes
            time.sleep(0.05)
        time.sleep(rng.uniform(0.0, 2.0))
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    assert subprocess.run(command(tmp_path, out), stderr=subprocess.DEVNULL, check=False).returncode == 0
    assert what_was_found(TINY, out) == what_was_found(TINY, finished)


def test_an_interrupt_stops_the_workers_too(tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(command(tmp_path, out), stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not folder_of(policy(0), out).exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    children = [int(x) for x in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]
    assert children
    process.send_signal(signal.SIGINT)
    process.wait(60)
    assert process.returncode != 0
    assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]
    open_results(out)  # the folder is intact
