"""Model files: read without leaving their folder, made into one text, joints held."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np

from planspace.errors import PlanspaceError, unknown
from planspace.store import read_bytes

MAX_MODEL_BYTES = 16 << 20


def read_model(path: Path, joints: Sequence[str] | None = None) -> str:
    """Reads a model file as one self-contained MJCF text.

    Args:
        path: the MJCF file; includes and meshes are merged into the text, pictures on surfaces left out.
        joints: the joints that are to move. The others are held where the model puts them: they are taken
            out, with the actuators and sensors that stand on them. None keeps all.

    Raises:
        PlanspaceError: it cannot be read or does not compile (with MuJoCo's message, which has the line), or
            it refers to a file outside its folder, or to one that text cannot hold (a height field, a skin).
        UsageError: a joint is not in the model.
    """
    text = read_text(path)
    files = list(_referred_files(path, text, {path.resolve()}, path.parent.resolve()))
    try:
        spec = mujoco.MjSpec.from_file(str(path)) if files else mujoco.MjSpec.from_string(text)
        known = [joint.name for joint in spec.joints]
        for name in joints or ():
            if name not in known:
                raise unknown("joint", name, known)
        held = [name for name in known if joints is not None and name not in joints]
        if not files and not held:
            spec.compile()
            return text
        for name in held:
            _hold(spec, name)
        _take_in_files(spec)
        spec.compile()
        return spec.to_xml()
    except ValueError as error:
        raise PlanspaceError(f"{path} does not compile: {' '.join(str(error).split())}") from error


def read_text(path: Path) -> str:
    """Reads a file of a model, of bounded size.

    Raises:
        PlanspaceError: missing, too large, or no text.
    """
    data = read_bytes(path)
    if len(data) > MAX_MODEL_BYTES:
        raise PlanspaceError(f"{path} has {len(data)} bytes; a model file has at most {MAX_MODEL_BYTES}.")
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise PlanspaceError(f"{path} is no text: {error}.") from error


def _referred_files(path: Path, text: str, seen: set[Path], folder: Path) -> Iterator[Path]:
    """The files a model refers to, directly or not; refuses what lies outside the model's folder."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise PlanspaceError(f"{path} is not well-formed XML: {error}.") from error
    compilers = [element.attrib for element in root.iter("compiler")]
    for element in root.iter():
        name = element.get("file")
        if name is None:
            continue
        key = {"mesh": "meshdir", "texture": "texturedir"}.get(element.tag, "")
        places = {c.get(key, c.get("assetdir", "")) for c in compilers} if key else set()
        files = [(folder / place / name).resolve() for place in sorted(places | {""})]
        if "://" in name or name.startswith("file:") or not all(f.is_relative_to(folder) for f in files):
            raise PlanspaceError(f"{path} refers to {name!r}, outside its folder; copy it beside the model.")
        if element.tag not in ("include", "mesh", "texture"):
            raise PlanspaceError(
                f"{path} refers to {name!r}: a dataset holds its whole model as text, which cannot hold a "
                f"{element.tag} in a file."
            )
        yield files[0]
        if element.tag == "include":
            if files[0] in seen:
                raise PlanspaceError(f"{path} includes {name!r} twice, or in a circle.")
            seen.add(files[0])
            yield from _referred_files(folder / name, read_text(files[0]), seen, folder)


def _take_in_files(spec: mujoco.MjSpec) -> None:
    """Writes the vertices of meshes into the model, and puts plain colour in place of pictures."""
    model = spec.compile()
    for mesh in [m for m in spec.meshes if m.file]:
        i = model.mesh(mesh.name).id
        first, count = model.mesh_vertadr[i], model.mesh_vertnum[i]
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.mesh_quat[i])  # MuJoCo moved the vertices into the mesh's own frame
        vertices = model.mesh_vert[first : first + count] @ turn.reshape(3, 3).T + model.mesh_pos[i]
        first, count = model.mesh_faceadr[i], model.mesh_facenum[i]
        mesh.uservert = vertices.ravel().tolist()
        mesh.userface = model.mesh_face[first : first + count].ravel().tolist()
        mesh.file, mesh.scale = "", [1.0, 1.0, 1.0]
        mesh.refpos, mesh.refquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    for texture in [t for t in spec.textures if t.file or any(t.cubefiles)]:
        texture.file, texture.cubefiles = "", [""] * 6
        texture.builtin, texture.width, texture.height = mujoco.mjtBuiltin.mjBUILTIN_FLAT, 8, 8
        texture.rgb1 = texture.rgb2 = [0.8, 0.8, 0.8]


def _hold(spec: mujoco.MjSpec, joint: str) -> None:
    for actuator in [a for a in spec.actuators if a.target == joint]:
        spec.delete(actuator)
    on_joint = mujoco.mjtObj.mjOBJ_JOINT
    for sensor in [s for s in spec.sensors if s.objtype == on_joint and s.objname == joint]:
        spec.delete(sensor)
    spec.delete(spec.joint(joint))
