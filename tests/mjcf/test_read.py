from pathlib import Path

import mujoco
import numpy as np
import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.compile import load_model
from planspace.mjcf.read import read_model

TWO_JOINTS = """<mujoco><worldbody>
  <body><joint name="a" type="hinge"/><geom name="ga" size="0.1"/>
    <body pos="0 0 1"><joint name="b" type="hinge"/><geom name="gb" size="0.1"/></body></body>
</worldbody>
<actuator><motor name="ma" joint="a"/><motor name="mb" joint="b"/></actuator>
<sensor><jointpos name="sb" joint="b"/></sensor></mujoco>"""


def write(folder: Path, text: str, name: str = "model.xml") -> Path:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def test_a_model_in_one_file_is_read_unchanged(tmp_path: Path) -> None:
    assert read_model(write(tmp_path, TWO_JOINTS), ("a", "b")) == TWO_JOINTS
    assert read_model(write(tmp_path, TWO_JOINTS)) == TWO_JOINTS


def test_other_joints_are_locked(tmp_path: Path) -> None:
    model = load_model(read_model(write(tmp_path, TWO_JOINTS), ("a",)))
    assert (model.nq, model.nu, model.nsensor, model.nbody) == (1, 1, 0, 3)  # b's body stays
    assert model.joint(0).name == "a"


def test_includes_are_merged(tmp_path: Path) -> None:
    write(tmp_path, '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/></worldbody></mujoco>',
          "parts/floor.xml")  # fmt: skip
    text = TWO_JOINTS.replace("<mujoco>", '<mujoco><include file="parts/floor.xml"/>')
    merged = read_model(write(tmp_path, text))
    assert "include" not in merged
    assert load_model(merged).ngeom == 3


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('<include file="../secret.xml"/>', "'../secret.xml', outside its folder"),
        ('<include file="/etc/passwd"/>', "'/etc/passwd', outside its folder"),
        ('<include file="file:///etc/passwd"/>', "outside its folder"),
        ('<include file="model.xml"/>', "includes 'model.xml' twice, or in a circle"),
        ('<include file="nowhere.xml"/>', "cannot read .*nowhere.xml"),
        ('<asset><mesh file="../a.stl"/></asset>', "'../a.stl', outside its folder"),
        ('<compiler meshdir="../"/><asset><mesh file="a.stl"/></asset>', "'a.stl', outside its folder"),
        ('<asset><texture type="cube" fileright="/etc/a.png"/></asset>', "'/etc/a.png', outside its folder"),
        ('<asset><mesh file="a.stl"/></asset>', "does not compile: .*a.stl"),
        ('<asset><hfield file="a.png"/></asset>', "cannot hold the file of an element <hfield>"),
        ("<nonsense/>", "does not compile: .*nonsense.*line 1"),
        ("<worldbody>", "is not well-formed XML: mismatched tag"),
    ],
)
def test_forbidden_content_is_rejected(inside: str, message: str, tmp_path: Path) -> None:
    write(tmp_path, "<mujoco/>", "secret.xml")
    with pytest.raises(PlanspaceError, match=message):
        read_model(write(tmp_path / "models", f"<mujoco>{inside}</mujoco>"))


def test_an_unknown_joint_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown joint 'aa'. Did you mean 'a'"):
        read_model(write(tmp_path, TWO_JOINTS), ("aa",))


TETRAHEDRON = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.5\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
WITH_MESH = """<mujoco><compiler meshdir="parts"/>
<asset><mesh name="m" file="m.obj" scale="1 2 1"/><texture name="t" type="2d" file="parts/t.png"/>
  <material name="skin" texture="t"/></asset>
<worldbody><body><joint name="h" axis="0 1 0"/>
  <geom type="mesh" mesh="m" material="skin" pos="0.1 0 0" euler="10 20 30"/></body></worldbody></mujoco>"""


def test_meshes_become_text_and_textures_a_plain_colour(tmp_path: Path) -> None:
    import matplotlib.image

    path = write(tmp_path, WITH_MESH)
    write(tmp_path, TETRAHEDRON, "parts/m.obj")
    matplotlib.image.imsave(tmp_path / "parts" / "t.png", np.zeros((4, 4, 3)))
    text = read_model(path, ("h",))
    assert "m.obj" not in text and "t.png" not in text
    model = load_model(text)  # from the text only
    original = mujoco.MjModel.from_xml_path(str(path))
    for field in ("body_mass", "body_inertia", "body_ipos", "geom_pos", "geom_quat"):
        np.testing.assert_allclose(getattr(model, field), getattr(original, field), rtol=1e-5, atol=1e-6)


def test_an_asset_folder_applies_to_included_files(tmp_path: Path) -> None:
    """MuJoCo applies the main file's meshdir to an included file's meshes."""
    write(tmp_path, '<mujoco><asset><mesh name="m" file="m.obj"/></asset></mujoco>', "models/part.xml")
    write(tmp_path, TETRAHEDRON, "m.obj")
    path = write(
        tmp_path, '<mujoco><compiler meshdir=".."/><include file="part.xml"/></mujoco>', "models/model.xml"
    )
    with pytest.raises(PlanspaceError, match="'m.obj', outside its folder"):
        read_model(path)


def test_another_format_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="not an MJCF model: its root element is <robot>"):
        read_model(write(tmp_path, '<robot><link name="l"><mesh filename="/etc/m.obj"/></link></robot>'))


FLEX = '<body name="b"><flexcomp name="f" count="3 3 3" dim="3" spacing="1 1 1"/></body>'


def test_compiling_prints_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = f"<mujoco><option gravity='0 0 nan'/><worldbody>{FLEX}</worldbody></mujoco>"
    load_model(read_model(write(tmp_path, text)))
    assert capfd.readouterr() == ("", "") and not Path("MUJOCO_LOG.TXT").exists()


def test_a_joint_can_be_locked_in_a_model_with_keyframes(tmp_path: Path) -> None:
    with_key = TWO_JOINTS.replace("</mujoco>", '<keyframe><key qpos="1 2" ctrl="0 0"/></keyframe></mujoco>')
    assert load_model(read_model(write(tmp_path, with_key), ("a",))).nq == 1
    coupled = TWO_JOINTS.replace("</mujoco>", '<equality><joint joint1="a" joint2="b"/></equality></mujoco>')
    with pytest.raises(PlanspaceError, match="the joints b cannot be locked: .*Add them to the joints"):
        read_model(write(tmp_path, coupled), ("a",))
