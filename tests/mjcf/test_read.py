import shutil
from pathlib import Path

import matplotlib.image
import mujoco
import numpy as np
import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.compile import _compiled, load_model
from planspace.mjcf.read import read_keyframe, read_model
from planspace.mjcf.same_model import different_fields
from planspace.mjcf.source import ModelFile

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
    for joints in (("a", "b"), None):
        source = read_model(ModelFile(write(tmp_path, TWO_JOINTS), joints))
        assert source.is_text and source.text == TWO_JOINTS


def test_other_joints_are_held(tmp_path: Path) -> None:
    model = load_model(read_model(ModelFile(write(tmp_path, TWO_JOINTS), ("a",))))
    assert (model.nq, model.nu, model.nsensor, model.nbody) == (1, 1, 0, 3)  # b's body stays
    assert model.joint(0).name == "a"


def test_an_included_file_belongs_to_the_model(tmp_path: Path) -> None:
    write(tmp_path, '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/></worldbody></mujoco>',
          "parts/floor.xml")  # fmt: skip
    text = TWO_JOINTS.replace("<mujoco>", '<mujoco><include file="parts/floor.xml"/>')
    source = read_model(ModelFile(write(tmp_path, text)))
    assert list(source.contents) == ["model.xml", "parts/floor.xml"]
    shutil.rmtree(tmp_path)
    assert load_model(source).ngeom == 3


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('<include file="../secret.xml"/>', "'../secret.xml', outside the folder"),
        ('<include file="/etc/passwd"/>', "'/etc/passwd', outside the folder"),
        ('<include file="file:///etc/passwd"/>', "outside the folder"),
        ('<include file="model.xml"/>', "includes 'model.xml' twice, or in a circle"),
        ('<include file="nowhere.xml"/>', "cannot read .*nowhere.xml"),
        ('<asset><mesh file="../a.stl"/></asset>', "'../a.stl', outside the folder"),
        ('<compiler meshdir="../"/><asset><mesh file="a.stl"/></asset>', "'a.stl', outside the folder"),
        ('<asset><mesh file="a.stl"/></asset>', "does not compile: .*a.stl"),
        ('<asset><hfield name="h" size="1 1 1 1" file="a.png"/></asset>', "does not compile: .*a.png"),
        ('<asset><model name="m" file="model.xml"/></asset>', "attaches 'model.xml' to itself"),
        ("<nonsense/>", "does not compile: .*nonsense.*line 1"),
        ("<worldbody>", "is not well-formed XML: mismatched tag"),
    ],
)
def test_forbidden_content_is_rejected(inside: str, message: str, tmp_path: Path) -> None:
    write(tmp_path, "<mujoco/>", "secret.xml")
    with pytest.raises(PlanspaceError, match=message):
        read_model(ModelFile(write(tmp_path / "models", f"<mujoco>{inside}</mujoco>")))


def test_an_unknown_joint_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown joint 'aa'. Did you mean 'a'"):
        read_model(ModelFile(write(tmp_path, TWO_JOINTS), ("aa",)))


TETRAHEDRON = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.5\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
WITH_MESH = """<mujoco><compiler meshdir="parts"/>
<asset><mesh name="m" file="m.obj" scale="1 2 1"/><texture name="t" type="2d" file="parts/t.png"/>
  <material name="skin" texture="t"/></asset>
<worldbody><body><joint name="h" axis="0 1 0"/>
  <geom type="mesh" mesh="m" material="skin" pos="0.1 0 0" euler="10 20 30"/></body></worldbody></mujoco>"""


def test_a_model_with_files_is_the_same_model_without_them(tmp_path: Path) -> None:
    """Nothing is rounded, and pictures, which do not change the dynamics, are left out."""
    exact = "0.123456789012345"
    text = WITH_MESH.replace("<joint ", f'<joint damping="{exact}" ')
    path = write(tmp_path / "models", text)
    write(tmp_path / "models", TETRAHEDRON, "parts/m.obj")
    matplotlib.image.imsave(tmp_path / "models" / "parts" / "t.png", np.zeros((4, 4, 3)))
    original = mujoco.MjModel.from_xml_path(str(path))
    source = read_model(ModelFile(path, ("h",)))
    assert list(source.contents) == ["model.xml", "parts/m.obj"]
    shutil.rmtree(tmp_path / "models")
    model = load_model(source)
    assert model.dof_damping[0] == float(exact)
    model.opt.disableflags = original.opt.disableflags  # the silent reset of diverged states
    assert different_fields(original, model) == []
    original.dof_damping[0] += 1e-15
    assert different_fields(original, model) == ["dof_damping"]


def test_meshes_may_lie_next_to_the_folder_of_the_model(tmp_path: Path) -> None:
    """As in gymnasium-robotics and ROS: the main file's meshdir also holds for included files."""
    write(tmp_path, '<mujoco><asset><mesh name="m" file="m.obj"/></asset></mujoco>', "mjcf/part.xml")
    write(tmp_path, TETRAHEDRON, "meshes/m.obj")
    text = """<mujoco><compiler meshdir="../meshes"/><include file="part.xml"/>
      <worldbody><body><joint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
    path = write(tmp_path, text, "mjcf/model.xml")
    source = read_model(ModelFile(path, root=tmp_path))
    assert list(source.contents) == ["mjcf/model.xml", "meshes/m.obj", "mjcf/part.xml"]
    assert load_model(source).nmesh == 1
    with pytest.raises(PlanspaceError, match="'m.obj', outside the folder of the problem file. Move"):
        read_model(ModelFile(path))


def test_attached_models_are_read(tmp_path: Path) -> None:
    write(tmp_path, TWO_JOINTS, "arm/arm.xml")
    text = """<mujoco><asset><model name="arm" file="arm/arm.xml"/></asset><worldbody>
      <frame pos="0 0 1"><attach model="arm" prefix="left_"/></frame>
      <attach model="arm" prefix="right_"/></worldbody></mujoco>"""
    model = load_model(read_model(ModelFile(write(tmp_path, text))))
    assert [model.joint(i).name for i in range(4)] == ["left_a", "left_b", "right_a", "right_b"]


def test_another_format_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="not an MJCF model: its root element is <robot>"):
        read_model(
            ModelFile(write(tmp_path, '<robot><link name="l"><mesh filename="/etc/m.obj"/></link></robot>'))
        )


FLEX = '<body name="b"><flexcomp name="f" count="3 3 3" dim="3" spacing="1 1 1"/></body>'


def test_compiling_prints_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = f"<mujoco><option gravity='0 0 nan'/><worldbody>{FLEX}</worldbody></mujoco>"
    load_model(read_model(ModelFile(write(tmp_path, text))))
    assert capfd.readouterr() == ("", "") and not Path("MUJOCO_LOG.TXT").exists()


def test_unnamed_joints_are_named_after_their_bodies(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body name="trunk"><freejoint/><geom size="0.1"/>
      <body name="leg"><joint axis="1 0 0"/><joint axis="0 1 0"/><geom size="0.1"/></body>
      <body><joint/><geom size="0.1"/></body></body></worldbody></mujoco>"""
    model = load_model(read_model(ModelFile(write(tmp_path, text))))
    assert [model.joint(i).name for i in range(4)] == ["trunk", "leg", "leg_2", "body3"]


GRIPPER = """<mujoco><compiler angle="radian"/><worldbody><body name="arm" euler="0.3 0.2 0.1" pos="1 2 3">
    <joint name="lift" type="slide" axis="0 0 1"/><joint name="turn" axis="1 1 0" pos="0.1 0 0" ref="0.4"/>
    <joint name="wrist" axis="0 0 1" pos="0 0.2 0"/><geom size="0.1" pos="0.1 0 0"/>
    <body name="left" pos="0.5 0 0"><joint name="f1" type="slide" axis="0 1 0"/><geom size="0.02"/></body>
    <body name="right" pos="0.5 0 0"><joint name="f2" type="slide" axis="0 1 0"/><geom size="0.02"/>
      <body name="tip" quat="0.9 0 0.1 0.3"><joint name="ball" type="ball" pos="0 0 0.05"/>
        <geom type="box" size="0.01 0.02 0.03" pos="0.1 0 0"/></body></body></body></worldbody>
  <tendon><fixed name="split"><joint joint="f1" coef="0.5"/><joint joint="f2" coef="0.5"/></fixed></tendon>
  <equality><joint name="same" joint1="f1" joint2="f2"/></equality>
  <actuator><motor name="m" joint="wrist" gear="10"/><position name="grip" tendon="split"/></actuator>
  <sensor><tendonpos tendon="split"/><actuatorfrc actuator="grip"/><jointpos joint="wrist"/></sensor>
  <keyframe><key name="home" qpos="0.1 0.7 -0.2 0.03 0.03 0.5 0.5 0.5 0.5"/></keyframe></mujoco>"""


@pytest.mark.parametrize("moving", [("wrist",), ("turn",), ("lift", "wrist"), ("lift", "turn"), ("ball",)])
def test_held_joints_keep_the_pose_of_a_keyframe(moving: tuple[str, ...], tmp_path: Path) -> None:
    whole = mujoco.MjModel.from_xml_string(GRIPPER)
    source = read_model(ModelFile(write(tmp_path, GRIPPER), moving, keyframe="home"))
    part = load_model(source)
    assert [part.joint(i).name for i in range(part.njnt)] == list(moving)
    assert (part.ntendon, part.neq, part.nkey) == (0, 0, 0)
    assert part.nu == ("wrist" in moving)
    a, b = mujoco.MjData(whole), mujoco.MjData(part)
    a.qpos[:] = whole.key_qpos[0]
    for name in moving:
        b.joint(name).qpos[:] = a.joint(name).qpos = a.joint(name).qpos + (0.3 if name != "ball" else 0.0)
    mujoco.mj_kinematics(whole, a)
    mujoco.mj_kinematics(part, b)
    np.testing.assert_allclose(b.xpos, a.xpos, atol=1e-12)
    np.testing.assert_allclose(b.xmat, a.xmat, atol=1e-12)
    np.testing.assert_allclose(b.geom_xpos, a.geom_xpos, atol=1e-12)


def test_a_model_is_compiled_once_whole_and_once_with_held_joints(tmp_path: Path) -> None:
    _compiled.cache_clear()
    write(tmp_path, GRIPPER, "parts/arm.xml")
    path = write(tmp_path, '<mujoco><include file="parts/arm.xml"/></mujoco>')
    source = read_model(ModelFile(path, ("wrist",), keyframe="home"))
    read_keyframe(source, ("wrist",), "home")
    assert load_model(source).njnt == 1
    assert _compiled.cache_info().misses == 2  # the user's own files are compiled, too, to compare


def test_the_state_of_a_keyframe(tmp_path: Path) -> None:
    source = read_model(ModelFile(write(tmp_path, GRIPPER), ("wrist", "ball"), keyframe="home"))
    found = read_keyframe(source, ("ball", "wrist"), "home")
    assert found == ([0.5, 0.5, 0.5, 0.5, -0.2], [0.0, 0.0, 0.0, 0.0], [])
    with pytest.raises(UsageError, match="unknown keyframe 'hom'. Did you mean 'home'"):
        read_keyframe(source, ("wrist",), "hom")


def test_replicated_joints_have_names(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><replicate count="2" offset="1 0 0"><body name="p"><joint name="h"/>
      <geom size="0.1"/></body></replicate></worldbody></mujoco>"""
    model = load_model(read_model(ModelFile(write(tmp_path, text), ("h0",))))
    assert [model.joint(i).name for i in range(model.njnt)] == ["h0"]


def test_what_cannot_be_held_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, GRIPPER)
    with pytest.raises(PlanspaceError, match="the tendon 'split' couples 'f2', which is held, to 'f1'"):
        read_model(ModelFile(path, ("wrist", "f1")))
    with pytest.raises(UsageError, match="unknown keyframe 'hom'. Did you mean 'home'"):
        read_model(ModelFile(path, ("wrist",), keyframe="hom"))
    with pytest.raises(UsageError, match="the joint 'ball' has 4 positions, got"):
        read_model(ModelFile(path, ("wrist",), hold={"ball": (0.0,)}))
    with pytest.raises(UsageError, match="'wrist' is in both joints and held"):
        read_model(ModelFile(path, ("wrist",), hold=["wrist"]))


def test_a_free_body_is_held_only_if_the_user_says_so(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/><geom size="0.1"/>
      <body><joint name="leg"/><geom size="0.1" pos="0 0 -1"/></body></body></worldbody></mujoco>"""
    path = write(tmp_path, text)
    with pytest.raises(PlanspaceError, match=r"free joint 'trunk' is not in joints.* `held: \[trunk\]`"):
        read_model(ModelFile(path, ("leg",)))
    for hold in ("all", ["trunk"], {"trunk": (0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0)}):
        model = load_model(read_model(ModelFile(path, ("leg",), hold=hold)))
        assert (model.nq, model.body_pos[1, 2]) == (1, 2.0 if isinstance(hold, dict) else 1.0)
