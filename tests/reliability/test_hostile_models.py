"""Hostile models are rejected, and nothing else happens."""

import sys
from pathlib import Path

import gymnasium
import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf import subprocess_model
from planspace.mjcf.model_check import parse_model
from planspace.mjcf.read import read_model
from planspace.mjcf.source import ModelFile, ModelSource
from planspace.mjcf.subprocess_model import check_compiles

from .audit import assert_rejected, nothing_else_happens
from .hostile_models import BODY, BOMB, MODELS, OUTSIDE


@pytest.mark.parametrize("trick", MODELS)
def test_hostile_models_are_rejected(trick: str, models: Path) -> None:
    inside, message = MODELS[trick]
    (models / "model.xml").write_text(f"<mujoco>{inside}</mujoco>")
    assert_rejected(models, lambda: read_model(ModelFile(models / "model.xml")), message)


def test_pictures_are_left_out_unread(models: Path) -> None:
    texture = '<asset><texture type="2d" file="/etc/t.png"/></asset>'
    (models / "model.xml").write_text(f"<mujoco>{texture}<worldbody>{BODY}</worldbody></mujoco>")
    with nothing_else_happens(models):
        assert read_model(ModelFile(models / "model.xml")).files == ()


def test_the_models_of_gymnasium_are_within_the_limits() -> None:
    assets = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
    files = sorted(assets.glob("*.xml"))
    assert len(files) > 10
    for file in files:
        parse_model(file.read_text(), str(file))


@pytest.mark.parametrize("text", [BOMB, OUTSIDE], ids=["bomb", "outside"])
def test_entities_are_rejected(text: str, models: Path) -> None:
    (models / "model.xml").write_text(text)
    assert_rejected(models, lambda: read_model(ModelFile(models / "model.xml")), "entities")


# --- compiling in a subprocess -------------------------------------------------------------------------

TEXT = f"<mujoco>{{}}<worldbody>{BODY}</worldbody></mujoco>"


def test_a_model_is_read_in_a_subprocess(models: Path) -> None:
    (models / "model.xml").write_text(TEXT.format(""))
    read = subprocess_model.read_model_in_subprocess(ModelFile(models / "model.xml"))
    assert read == read_model(ModelFile(models / "model.xml")) == ModelSource(TEXT.format(""))
    with pytest.raises(UsageError, match="unknown joint 'x'"):
        subprocess_model.read_model_in_subprocess(ModelFile(models / "model.xml", ["x"]))


def test_an_error_in_the_subprocess_is_raised_here() -> None:
    with pytest.raises(PlanspaceError, match="does not compile: .*nonsense"):
        check_compiles("<mujoco><nonsense/></mujoco>")


@pytest.mark.slow
def test_the_memory_of_the_subprocess_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    large = TEXT.format('<size memory="1000M"/>')
    check_compiles(large)
    monkeypatch.setattr(subprocess_model, "MEMORY_BYTES", 1 << 30)
    with pytest.raises(PlanspaceError, match="does not compile: .*Could not allocate memory"):
        check_compiles(large)


def test_the_time_of_the_subprocess_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess_model, "WALL_S", 0.01)
    with pytest.raises(PlanspaceError, match="does not compile within .* 4 GiB of memory"):
        check_compiles(TEXT.format(""))


@pytest.mark.slow
def test_the_cpu_time_of_the_subprocess_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess_model, "CPU_S", 2)
    crowd = '<replicate count="4900" offset="1 0 0"><geom name="g" size="0.1"/></replicate>'  # 5 s
    with pytest.raises(PlanspaceError, match="does not compile within 2 s of CPU time"):
        check_compiles(f"<mujoco><worldbody>{crowd}</worldbody></mujoco>")


def test_a_model_that_crashes_mujoco_is_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "python").write_text("#!/bin/sh\nkill -SEGV $$\n")
    (tmp_path / "python").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    with pytest.raises(PlanspaceError, match="does not compile within .* or crashes MuJoCo"):
        check_compiles("<mujoco/>")
