"""Shards of a study. Except for the last test, the units' results are made up, so that nothing is run."""

import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from planspace.cli import main
from planspace.cli.entry import parse
from planspace.errors import PlanspaceError, UsageError
from planspace.storage.json_files import read_json, write_json
from planspace.study.design import Study
from planspace.study.execute import has_folder, is_done, keep_result, result_file
from planspace.study.grid import make_study
from planspace.study.results import FitResult, Found, PlansResult, PoliciesResult, UnitResult
from planspace.study.run import open_results, run_study
from planspace.study.run_summary import GEOMETRY_ROWS
from planspace.study.shards import Shard, divide, merge_shards, open_shard
from planspace.study.slurm import slurm_script
from planspace.study.summary import read_findings, summarise
from planspace.study.tables import StudySummary, Time
from planspace.study.tidy import Row, read_rows, write_tidy
from planspace.study.unit import FitUnit, PlansUnit, PolicyUnit, Unit

from ..tiny_study import FIT, PLANS, RAW, TINY, what_was_found

METRICS = ("path_error", *(row[0] for row in GEOMETRY_ROWS))


def made_up(unit: Unit) -> Found:
    """A result that depends on nothing but the unit."""
    if isinstance(unit, PlansUnit):
        return PlansResult(unit.num, 1.5, 1.0, hash="plans")
    if isinstance(unit, FitUnit):
        return FitResult(unit.seed, dict.fromkeys(METRICS, 0.5), hash="fit")
    seed = float(unit.config.seed + 10 * bool(unit.fits))
    return PoliciesResult((unit.config.seed,), (4000, 8000), ((seed,), (seed + 2,)), (False,))


def run(study: Study, out: Path, seconds: float = 1.0) -> Path:
    open_results(out)
    for unit in study.units:
        keep_result(unit, out, UnitResult(made_up(unit), seconds, 1, cpu=f"CPU of {out.name}"))
    return out


@pytest.fixture
def three(tmp_path: Path) -> list[Path]:
    """The folders of three finished shards."""
    numbers = [Shard(i, 3) for i in (1, 2, 3)]
    folders = [open_shard(TINY, shard, tmp_path) for shard in numbers]
    parts = divide(TINY, 3)
    return [run(part, folder, 2.0 + i) for i, (part, folder) in enumerate(zip(parts, folders, strict=True))]


@pytest.mark.parametrize("text", ["0/3", "4/3", "1/0", "3", "1/3/3", "-1/3", "1.0/3", "a/b", " 1/3"])
def test_a_shard_that_makes_no_sense_is_rejected(text: str) -> None:
    with pytest.raises(UsageError, match=r"`--shard` must be I/N with I from 1 to N, such as 2/3, got"):
        Shard.parse(text)
    assert Shard.parse("3/3") == Shard(3, 3)


@pytest.mark.parametrize(("name", "count"), [("paper", 10), ("demos", 3), ("shaping", 1), ("recipe", 23)])
def test_every_policy_is_in_one_shard_with_all_that_it_needs(name: str, count: int) -> None:
    study = make_study(name, "half")
    parts = divide(study, count)
    policies = [unit.name for part in parts for unit in part.units if isinstance(unit, PolicyUnit)]
    assert sorted(policies) == sorted(unit.name for unit in study.units if isinstance(unit, PolicyUnit))
    assert {unit.name for part in parts for unit in part.units} == {unit.name for unit in study.units}
    assert all(part.arms for part in parts)
    reordered = replace(study, arms=study.arms[::-1])
    names = [{unit.name for unit in part.units} for part in parts]
    assert [{unit.name for unit in part.units} for part in divide(reordered, count)] == names


def test_shards_take_about_the_same_time() -> None:
    study = make_study("demos", "half")
    times = [sum(unit.cost for unit in part.units) for part in divide(study, 3)]
    assert max(times) < 1.2 * min(times)
    assert sum(times) < 1.1 * sum(unit.cost for unit in study.units)  # embeddings are seldom made twice


def test_a_study_has_at_most_one_shard_per_unit_of_policies() -> None:
    assert [len(part.arms) for part in divide(TINY, 4)] == [1, 1, 1, 1]
    message = "study tiny cannot be divided into 5 shards: it has only 4 units of policies"
    with pytest.raises(UsageError, match=message):
        divide(TINY, 5)


def rows_and_tables(out: Path) -> tuple[list[Row], StudySummary]:
    """The rows of results.csv and the tables, without times."""
    findings = read_findings(TINY, out)
    write_tidy(findings, out / "results.csv")
    rows = [row for row in read_rows(out / "results.csv") if not row.metric.endswith("_core_seconds")]
    tables = summarise(findings)
    costs = [replace(row, seed_core_seconds=None, needs_core_seconds=None) for row in tables.costs]
    return rows, replace(tables, costs=costs, time=Time(0, 0, 0, 0))


def test_merged_shards_give_the_tables_of_the_whole_study(three: list[Path], tmp_path: Path) -> None:
    whole = run(TINY, tmp_path / "whole")
    merge_shards(TINY, three[::-1], tmp_path / "merged")
    rows, tables = rows_and_tables(tmp_path / "merged")
    assert (rows, tables) == rows_and_tables(whole) and len(rows) > 20
    merge_shards(TINY, three, tmp_path / "merged")  # again: everything is there


def other_settings(three: list[Path], tmp_path: Path) -> list[Path]:
    study = replace(TINY, seeds=10, arms=(replace(RAW, units=RAW.units[:1]),))
    return [three[0], open_shard(study, Shard(1, 1), tmp_path / "other"), three[2]]


def other_versions(three: list[Path], tmp_path: Path) -> list[Path]:
    config = read_json(three[1] / "config.json")
    config["versions"]["jax"] = "0.0.1"
    write_json(three[1] / "config.json", config)
    return three


def unfinished(three: list[Path], tmp_path: Path) -> list[Path]:
    result_file(FIT, three[0]).unlink()
    return three


def other_division(three: list[Path], tmp_path: Path) -> list[Path]:
    return [three[0], open_shard(TINY, Shard(2, 4), tmp_path)]


def other_result(three: list[Path], tmp_path: Path) -> list[Path]:
    result_file(PLANS, three[1]).unlink()
    keep_result(PLANS, three[1], UnitResult(PlansResult(11, 1.5, 1.0, hash="other"), 1.0, 1))
    return three


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            other_settings,
            r"1-of-1 \(shard 1 of 1\) was made with other settings: seeds was 10, now 'def",
        ),
        (other_versions, r"\(shard 2 of 3\) was made .* version of jax was '0.0.1', now '[\d.]+'\. Give"),
        (lambda three, _: three[::2], r"^shard 2 of 3 is missing\. Give the folders of all shards\."),
        (lambda three, _: three[:1], r"^shards 2, 3 of 3 are missing\."),
        (unfinished, r"^shard 1 of 3 is not finished: .*1-of-3 lacks 1 of 3 units\. .* --shard 1/3"),
        (lambda three, _: [*three, three[0]], r"^shard 1 of 3 is given twice: .*1-of-3 and .*1-of-3\."),
        (other_division, r"of different divisions: .* is shard 1 of 3, .* is shard 2 of 4\."),
        (
            other_result,
            r"^plans-\w+ has different results in .*-1-of-3 and .*-2-of-3, because their",
        ),
        (lambda _, tmp_path: [tmp_path], r" is not a shard of a study: it has no shard\.json\."),
    ],
)
def test_shards_that_do_not_make_up_the_study_are_rejected(
    make: Callable[[list[Path], Path], list[Path]], message: str, three: list[Path], tmp_path: Path
) -> None:
    with pytest.raises(PlanspaceError, match=message):
        merge_shards(TINY, make(three, tmp_path), tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_a_shard_cannot_be_continued_with_other_settings(three: list[Path], tmp_path: Path) -> None:
    assert open_shard(TINY, Shard(1, 3), tmp_path) == three[0]
    fewer = replace(TINY, arms=TINY.arms[1:], parts=("z",))
    with pytest.raises(PlanspaceError, match=r"other settings: only was \[\], now \['z'\]\. Give the same"):
        open_shard(fewer, Shard(1, 3), tmp_path)


def test_the_command_line_runs_one_shard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[tuple[set[str], Path]] = []

    def record(study: Study, out: Path, workers: int) -> dict[str, str]:
        ran.append(({unit.name for unit in study.units}, out))
        return {}

    monkeypatch.setattr("planspace.study.run.run_study", record)
    only = ["--only", "swingup, TRPO/raw", "--out", str(tmp_path)]
    assert main(["study", "paper", "--shard", "2/3", *only]) == 0
    part = divide(make_study("paper", "half").only(["swingup, TRPO/raw"]), 3)[1]
    folder = tmp_path / "paper-half-shard-2-of-3"
    assert ran == [({unit.name for unit in part.units}, folder)]
    assert capsys.readouterr().out == f"shard 2 of 3, 1 unit: {folder}\n"


def test_the_script_for_slurm_runs_the_shards_and_the_merge(tmp_path: Path) -> None:
    study = make_study("paper", "half", seeds=10).only(["swingup, TRPO/raw", "it's"])
    out = tmp_path / "two words"
    script = slurm_script(study, 2, out, workers=8)
    assert "\n#SBATCH --array=1-2\n" in script and "\n#SBATCH --cpus-per-task=8\n" in script
    for i in (1, 2):
        (out / f"paper-half-shard-{i}-of-2").mkdir(parents=True)
    fake = tmp_path / "bin" / "planspace"
    fake.parent.mkdir()
    fake.write_text('#!/bin/bash\nprintf "%s\\0" "$@"\n')
    fake.chmod(0o755)
    (tmp_path / "script").write_text(script)

    def parsed(*arguments: str) -> object:
        path = f"{fake.parent}{os.pathsep}{os.environ['PATH']}"
        slurm = {"SLURM_ARRAY_TASK_ID": "2", "SLURM_CPUS_PER_TASK": "8"}
        command = ["bash", "-u", str(tmp_path / "script"), *arguments]
        done = subprocess.run(command, env={"PATH": path, **slurm}, capture_output=True, check=True)
        return parse(done.stdout.decode().split("\0")[:-1])

    common = ["study", "paper", "--seeds", "10", "--only", "swingup, TRPO/raw", "--only", "it's"]
    common += ["--out", str(out)]
    assert parsed() == parse([*common, "--workers", "8", "--shard", "2/2"])
    folders = [str(out / f"paper-half-shard-{i}-of-2") for i in (1, 2)]
    assert parsed("merge") == parse([*common, "--merge", *folders])
    assert subprocess.run(["bash", "-n", str(tmp_path / "script")], check=False).returncode == 0


@pytest.mark.nightly
def test_three_shards_find_what_the_whole_study_finds(finished: Path, tmp_path: Path) -> None:
    parts, folders = divide(TINY, 3), []
    for i, part in enumerate(parts):
        folders.append(open_shard(TINY, Shard(i + 1, 3), tmp_path))
        assert run_study(part, folders[-1], workers=2) == {}
    assert is_done(FIT, folders[0]) and is_done(FIT, folders[1])  # both make the embedding
    merge_shards(TINY, folders, tmp_path / "merged")
    assert what_was_found(TINY, tmp_path / "merged") == what_was_found(TINY, finished)
    assert rows_and_tables(tmp_path / "merged") == rows_and_tables(
        shutil.copytree(finished, tmp_path / "one")
    )
    assert has_folder(FIT, tmp_path / "merged")
