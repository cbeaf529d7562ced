"""Reading model files: includes and meshes are merged into one text, and joints can be locked."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from planspace.errors import PlanspaceError, unknown
from planspace.mjcf.compile import MUJOCO_ERRORS, compiling
from planspace.mjcf.model_budget import check_budget
from planspace.mjcf.model_check import FILE_ATTRIBUTES, check_assets, parse_model
from planspace.storage.files import read_bytes

MAX_MODEL_BYTES = 16 << 20


def read_model(path: Path, joints: Sequence[str] | None = None) -> str:
    """Read a model file as one self-contained MJCF text.

    Args:
        path: the MJCF file; includes and meshes are merged into the text, textures from files are left out.
        joints: names of the joints that can move. The others are locked at the model's reference pose: they
            are removed together with their actuators and sensors. None keeps all joints.

    Raises:
        PlanspaceError: the file cannot be read or does not compile (MuJoCo's message gives the line), or it
            refers to a file outside its folder or to one that text cannot hold (a height field, a skin).
        UsageError: a joint is not in the model.
    """
    text, files = read_text(path), _referred_files(path)
    check_assets((file for file in files if file.exists()), str(path))  # the places where each file may be
    try:
        with compiling():
            spec = mujoco.MjSpec.from_file(str(path)) if files else mujoco.MjSpec.from_string(text)
            known = [joint.name for joint in spec.joints]
            for name in joints or ():
                if name not in known:
                    raise unknown("joint", name, known)
            locked = [name for name in known if joints is not None and name not in joints]
            if not files and not locked:
                spec.compile()
                return text
            _merge_files(spec)
    except MUJOCO_ERRORS as error:
        raise PlanspaceError(f"{path} does not compile: {' '.join(str(error).split())}") from error
    try:
        with compiling():
            for name in locked:
                _lock(spec, name)
            spec.compile()
            return spec.to_xml()
    except MUJOCO_ERRORS as error:
        raise PlanspaceError(
            f"{path}: the joints {', '.join(locked)} cannot be locked: {' '.join(str(error).split())}. Add "
            "them to the joints of the problem, or remove what refers to them from the model."
        ) from error


def read_text(path: Path) -> str:
    """Read one file of a model as text.

    Raises:
        PlanspaceError: the file is missing, too large, or not text.
    """
    try:
        return read_bytes(path, most=MAX_MODEL_BYTES, may_be_link=True).decode()
    except UnicodeDecodeError as error:
        raise PlanspaceError(f"{path} is not a text file: {error}.") from error


def _referred_files(path: Path) -> list[Path]:
    """The files that a model refers to, directly or through included files.

    Raises:
        PlanspaceError: a file is outside the model's folder, is included twice, or cannot become text.
    """
    folder = path.parent.resolve()
    roots = {path.resolve(): _root(path)}
    waiting, included_by = [(path, roots[path.resolve()])], []
    while waiting:
        file, root = waiting.pop()
        for element in root.iter("include"):
            name = element.get("file", "")
            included = _inside(file, folder, "", name)
            if included in roots:
                raise PlanspaceError(f"{file} includes {name!r} twice, or in a circle.")
            roots[included] = _root(included)
            included_by.append((element, roots[included]))
            waiting.append((included, roots[included]))
    # MuJoCo takes asset folders from any file's compiler element for all of them
    compilers = [element.attrib for root in roots.values() for element in root.iter("compiler")]
    referred = [file for file in roots if file != path.resolve()]
    for file, root in roots.items():
        for element in root.iter():
            for attribute in FILE_ATTRIBUTES & element.attrib.keys():
                if element.tag == "include":
                    continue
                name = element.attrib[attribute]
                if element.tag not in ("mesh", "texture"):
                    raise PlanspaceError(
                        f"{file} refers to {name!r}: a dataset holds its model as text, which cannot hold "
                        f"the file of an element <{element.tag}>."
                    )
                key = {"mesh": "meshdir", "texture": "texturedir"}[element.tag]
                places = {""} | {c.get(k, "") for c in compilers for k in (key, "assetdir")}
                referred += [_inside(file, folder, place, name) for place in sorted(places)]
    for element, root in included_by:
        element.extend(root)
    check_budget(roots[path.resolve()], str(path))  # all files together
    return referred


def _root(path: Path) -> ElementTree.Element:
    return parse_model(read_text(path), str(path))


def _inside(path: Path, folder: Path, place: str, name: str) -> Path:
    file = (folder / place / name).resolve()
    if ":" in name or not file.is_relative_to(folder):
        raise PlanspaceError(f"{path} refers to {name!r}, outside its folder; copy it next to the model.")
    return file


def _merge_files(spec: mujoco.MjSpec) -> None:
    """Write the vertices of mesh files into the model, and replace texture files by a plain colour."""
    model = spec.compile()
    for mesh in [m for m in spec.meshes if m.file]:
        i = model.mesh(mesh.name).id
        first, count = model.mesh_vertadr[i], model.mesh_vertnum[i]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.mesh_quat[i])  # MuJoCo moved the vertices to the mesh's frame
        vertices = model.mesh_vert[first : first + count] @ rotation.reshape(3, 3).T + model.mesh_pos[i]
        first, count = model.mesh_faceadr[i], model.mesh_facenum[i]
        mesh.uservert = vertices.ravel().tolist()
        mesh.userface = model.mesh_face[first : first + count].ravel().tolist()
        mesh.file, mesh.scale = "", [1.0, 1.0, 1.0]
        mesh.refpos, mesh.refquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    for texture in [t for t in spec.textures if t.file or any(t.cubefiles)]:
        texture.file, texture.cubefiles = "", [""] * 6
        texture.builtin, texture.width, texture.height = mujoco.mjtBuiltin.mjBUILTIN_FLAT, 8, 8
        texture.rgb1 = texture.rgb2 = [0.8, 0.8, 0.8]


def _lock(spec: mujoco.MjSpec, joint: str) -> None:
    """Remove a joint, its actuators and sensors, and all keyframes, which would no longer fit."""
    for key in list(spec.keys):
        spec.delete(key)
    removed = [a.name for a in spec.actuators if a.target == joint]
    for actuator in [a for a in spec.actuators if a.target == joint]:
        spec.delete(actuator)
    measured = {(mujoco.mjtObj.mjOBJ_JOINT, joint)} | {(mujoco.mjtObj.mjOBJ_ACTUATOR, a) for a in removed}
    for sensor in [s for s in spec.sensors if (s.objtype, s.objname) in measured]:
        spec.delete(sensor)
    spec.delete(spec.joint(joint))
