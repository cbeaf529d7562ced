"""Datasets whose model has several files or held joints."""

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from planspace.demos.describe import validate
from planspace.demos.load import load_demos
from planspace.errors import PlanspaceError
from planspace.mjcf.source import ModelSource
from planspace.mjcf.subprocess_model import check_compiles
from planspace.plan.demonstrations import plan_demos

LOOK = (
    """<mujoco><option timestep="0.0123456789"/><default><joint damping="0.123456789"/></default></mujoco>"""
)
ARM = """<mujoco><compiler meshdir="../meshes" angle="radian"/><include file="look.xml"/>
<asset><mesh name="link" file="link.obj"/></asset>
<worldbody><body><joint name="j" axis="0 1 0" range="-3.0000001 3"/><geom type="mesh" mesh="link" mass="1"/>
  <body pos="0.3 0 0"><joint name="tool" axis="0 1 0"/><geom size="0.02" mass="0.05" pos="0.1 0 0"/></body>
</body></worldbody>
<actuator><motor joint="j" ctrlrange="-9 9"/><motor joint="tool"/></actuator>
<keyframe><key name="home" qpos="0 0.7"/></keyframe></mujoco>"""
LINK = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.5\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
PROBLEM = """model: mjcf/arm.xml
joints: [j]
keyframe: home
start: {low: [0, 0], high: [0.3, 0]}
goal: [1.5, 0]
tolerance: 0.1
hold: false
settings: {max_edge_steps: 20, polish_max_iterations: 5}
"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two plans of an arm whose tool is held, with a mesh and an included file; the user's files are gone."""
    folder = tmp_path_factory.mktemp("robot")
    for name, text in (("mjcf/arm.xml", ARM), ("mjcf/look.xml", LOOK), ("meshes/link.obj", LINK)):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    (folder / "arm.yaml").write_text(PROBLEM)
    plan_demos(str(folder / "arm.yaml"), 2, out=folder / "demos", workers=0, verbose=False)
    shutil.rmtree(folder / "mjcf")
    shutil.rmtree(folder / "meshes")
    return folder / "demos"


def test_a_refused_model_does_not_overwrite_that_of_the_dataset(dataset: Path, tmp_path: Path) -> None:
    """It did, and the dataset could not be read any more."""
    kept = shutil.copytree(dataset, tmp_path / "demos")
    for name, text in (("mjcf/arm.xml", ARM), ("mjcf/look.xml", LOOK), ("meshes/link.obj", LINK + "\n")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "arm.yaml").write_text(PROBLEM)
    with pytest.raises(PlanspaceError, match="contains demonstrations made with other settings"):
        plan_demos(str(tmp_path / "arm.yaml"), 3, out=kept, workers=0, verbose=False)
    assert load_demos(kept).hash == load_demos(dataset).hash


def test_a_dataset_holds_the_files_of_its_model(dataset: Path) -> None:
    assert (dataset / "model" / "mjcf" / "arm.xml").read_text() == ARM
    source = load_demos(dataset).info.source
    assert source is not None
    assert sorted(source.contents) == ["meshes/link.obj", "mjcf/arm.xml", "mjcf/look.xml"]
    assert source.held == (("tool", (0.7,)),)
    model, space = load_demos(dataset).info.compile()
    assert (model.opt.timestep, model.dof_damping[0]) == (0.0123456789, 0.123456789)
    assert space.low[0] == -3.0000001


def test_demonstrations_replay_in_a_model_of_the_users_files(dataset: Path) -> None:
    """The tool is blocked by hand in the user's own model, as `held` says."""
    assert validate(dataset, replay_controls=True)["replay_error"] == 0.0
    model = mujoco.MjModel.from_xml_path(str(dataset / "model" / "mjcf" / "arm.xml"))
    model.dof_armature[1] = 1e12  # it cannot move
    demos, data = load_demos(dataset), mujoco.MjData(model)
    episode = demos.episode(0)
    data.qpos[:], data.qvel[:] = (episode.states[0, 0], 0.7), (episode.states[0, 1], 0.0)
    for control, state in zip(episode.controls, episode.states[1:], strict=True):
        data.ctrl[:] = (control[0], 0.0)
        mujoco.mj_step(model, data)
        np.testing.assert_allclose((data.qpos[0], data.qvel[0]), state, atol=1e-6)


def test_an_altered_model_file_is_refused(dataset: Path, tmp_path: Path) -> None:
    copied = tmp_path / "demos"
    shutil.copytree(dataset, copied)
    (copied / "model" / "mjcf" / "look.xml").write_text(LOOK.replace("0.123", "0.124"))
    with pytest.raises(
        PlanspaceError, match=r"look\.xml was altered or damaged: it does not have the SHA-256"
    ):
        load_demos(copied)
    (copied / "model" / "mjcf" / "look.xml").unlink()
    with pytest.raises(PlanspaceError, match=r"cannot read .*look\.xml"):
        load_demos(copied)


def test_a_copy_of_the_demonstrations_has_the_same_model(dataset: Path, tmp_path: Path) -> None:
    demos = load_demos(dataset)
    demos.save(tmp_path / "copy")
    assert load_demos(tmp_path / "copy").hash == demos.hash
    assert load_demos(tmp_path / "copy").info == demos.info
    check_compiles(demos.info.source or "")


def test_a_manifest_cannot_name_files_outside_its_folder(dataset: Path) -> None:
    from planspace.demos.state_info import parse_info

    info = load_demos(dataset).info.plain_with_files()
    assert parse_info(info) == load_demos(dataset).info
    for name in ("../secret", "/etc/passwd", "a/../../b", "c:\\x"):
        model = {"main": name, "files": {name: "00"}, "held": {}}
        with pytest.raises(ValueError, match="invalid file"):
            parse_info({**info, "model": model})


def test_a_source_is_described_by_hashes() -> None:
    source = ModelSource("<mujoco/>", "a.xml", (("b.xml", b"b"),), (("j", (0.5,)),))
    plain = source.plain()
    assert list(plain["files"]) == ["a.xml", "b.xml"] and plain["held"] == {"j": [0.5]}
    assert source.hash != ModelSource("<mujoco/>", "a.xml", (("b.xml", b"c"),), source.held).hash
