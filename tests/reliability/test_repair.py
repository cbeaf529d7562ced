"""Repair sets damaged files aside, and the command that made them makes them again as they were."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planspace.cli.repair import repair
from planspace.demos.load import load_demos
from planspace.embed.saved_embedding import load_embedding
from planspace.embed.training_log import read_log
from planspace.errors import PlanspaceError
from planspace.rl.history import load_history
from planspace.storage.arrays import read_arrays
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.study.execute import folder_of
from planspace.study.run import run_study, units_to_run

from ..tiny_study import FIT, PLANS, TINY, run_alone
from .loaders import REPAIRERS, Loader, opened, read_changed
from .saved_files import GOLDEN, POLICY, readers_of_golden, readers_of_study
from .test_readers import needs_pipes, time_limit


def damage(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 4
    file.write_bytes(data)


def damaged_names(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("damaged-*")}


@pytest.fixture
def golden(tmp_path: Path) -> Path:
    return shutil.copytree(GOLDEN, tmp_path / "golden")


def test_each_damaged_file_is_reported_once_and_set_aside(golden: Path) -> None:
    assert repair(golden) == []
    for file in readers_of_golden(golden):
        damage(file)
        (line,) = repair(golden)
        assert str(file) in line and f"damaged-1-{file.name}" in damaged_names(golden)
        assert repair(golden) == []
        shutil.rmtree(golden)
        shutil.copytree(GOLDEN, golden)


def content(out: Path) -> dict[str, Any]:
    """The content of a study, without times."""
    plans, fitted, trained = (folder_of(unit, out) for unit in (PLANS, FIT, POLICY))
    weights = read_arrays(trained / "policies.safetensors")
    return {
        "demos": load_demos(plans).hash,
        "embedding": load_embedding(fitted).hash,
        "log": [row.get("bound") for row in read_log(fitted)],
        "history": {name: array.tobytes() for name, array in load_history(trained).items()},
        "policies": {name: array.tobytes() for name, array in weights.items()},
    }


@pytest.mark.nightly
def test_a_repaired_file_is_made_again_as_it_was(finished: Path, tmp_path: Path) -> None:
    out = shutil.copytree(finished, tmp_path / "out")
    before = content(out)
    assert repair(out) == []
    for file in readers_of_study(out):
        damage(file)
        (line,) = repair(out)
        assert str(file) in line
        assert f"damaged-1-{file.name}" in damaged_names(out) or "shard" in file.name
        assert repair(out) == []
        if file.parent.name == "units":
            assert len(units_to_run(TINY, out)) == 1
            run_study(TINY, out, workers=1)
        else:
            run_alone(next(unit for unit in (PLANS, FIT, POLICY) if unit.name in file.parts), out)
        assert content(out) == before, file
        for path in out.rglob("damaged-*"):
            path.unlink()


def test_a_log_keeps_the_readable_lines(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    log.write_bytes(b'{"step": 1}\n{"step": \xff\n{"step": 3}\n{"ste')
    with pytest.raises(PlanspaceError, match="line 2 is damaged.*`planspace repair"):
        read_log(tmp_path)
    (line,) = repair(tmp_path)
    assert f"{log} had 2 damaged lines" in line
    assert [row["step"] for row in read_log(tmp_path)] == [1, 3]


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="the folder .*nowhere does not exist"):
        repair(tmp_path / "nowhere")


# --- untrusted folders -----------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=REPAIRERS)
def repairer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loader]:
    yield from opened(REPAIRERS[request.param], tmp_path_factory.mktemp("repairer"))


@settings(max_examples=6, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_a_repaired_untrusted_folder_has_no_damage(data: st.DataObject, repairer: Loader) -> None:
    read_changed(data, repairer)


@pytest.mark.nightly
@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_many_repaired_untrusted_folders_have_no_damage(data: st.DataObject, repairer: Loader) -> None:
    read_changed(data, repairer)


@needs_pipes
@pytest.mark.parametrize(
    "name", ["demos/manifest.json", "embedding/log.jsonl", "run/policies.json", "units/x.json"]
)
def test_pipes_are_set_aside(name: str, golden: Path) -> None:
    file = golden / name
    file.unlink(missing_ok=True)
    os.mkfifo(file)
    with time_limit():
        (line,) = repair(golden.parent)
        assert f"cannot read {file}: it is not a regular file" in line and repair(golden.parent) == []
    assert (file.parent / f"damaged-1-{file.name}").is_fifo()


def test_the_target_of_a_link_is_not_touched(golden: Path, tmp_path: Path) -> None:
    log = golden / "embedding" / "log.jsonl"
    log.unlink()
    (tmp_path / "thesis").write_text("years of work")
    log.symlink_to(tmp_path / "thesis")
    (line,) = repair(golden)
    assert f"{log} is a link out of its folder, to {tmp_path / 'thesis'}" in line
    assert (tmp_path / "thesis").read_text() == "years of work" and not log.exists()


@pytest.mark.parametrize("name", ["", "..", "/", "manifest.json", "../demos"])
def test_only_shards_are_moved(name: str, tmp_path: Path) -> None:
    folder = shutil.copytree(GOLDEN / "demos", tmp_path / "demos")
    manifest = read_sealed(folder / "manifest.json")
    manifest["shards"][0]["file"] = name
    write_sealed(folder / "manifest.json", manifest)
    assert len(repair(folder)) == 1 and repair(folder) == []
    assert damaged_names(tmp_path) == {"damaged-1-shard-00000.safetensors"}
