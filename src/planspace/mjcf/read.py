"""Model files: read without leaving their folder, made into one text, joints held."""

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
    files = _referred_files(path)
    check_assets((file for file in files if file.exists()), str(path))  # of the places where one may lie
    try:
        with compiling():
            spec = mujoco.MjSpec.from_file(str(path)) if files else mujoco.MjSpec.from_string(text)
            known = [joint.name for joint in spec.joints]
            for name in joints or ():
                if name not in known:
                    raise unknown("joint", name, known)
            held = [name for name in known if joints is not None and name not in joints]
            if not files and not held:
                spec.compile()
                return text
            _take_in_files(spec)
    except MUJOCO_ERRORS as error:
        raise PlanspaceError(f"{path} does not compile: {' '.join(str(error).split())}") from error
    try:
        with compiling():
            for name in held:
                _hold(spec, name)
            spec.compile()
            return spec.to_xml()
    except MUJOCO_ERRORS as error:
        raise PlanspaceError(
            f"{path}: the joints {', '.join(held)} cannot be held: {' '.join(str(error).split())}. Plan for "
            "them too, or take out of the model what refers to them."
        ) from error


def read_text(path: Path) -> str:
    """Reads a file of a model, of bounded size.

    Raises:
        PlanspaceError: missing, too large, or no text.
    """
    try:
        return read_bytes(path, most=MAX_MODEL_BYTES, may_be_link=True).decode()
    except UnicodeDecodeError as error:
        raise PlanspaceError(f"{path} is no text: {error}.") from error


def _referred_files(path: Path) -> list[Path]:
    """The files a model refers to, directly or not.

    Raises:
        PlanspaceError: one lies outside the model's folder, is included twice, or cannot become text.
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
                        f"{file} refers to {name!r}: a dataset holds its whole model as text, which cannot "
                        f"hold a {element.tag} in a file."
                    )
                key = {"mesh": "meshdir", "texture": "texturedir"}[element.tag]
                places = {""} | {c.get(k, "") for c in compilers for k in (key, "assetdir")}
                referred += [_inside(file, folder, place, name) for place in sorted(places)]
    for element, root in included_by:
        element.extend(root)
    check_budget(roots[path.resolve()], str(path))  # of all files together
    return referred


def _root(path: Path) -> ElementTree.Element:
    return parse_model(read_text(path), str(path))


def _inside(path: Path, folder: Path, place: str, name: str) -> Path:
    file = (folder / place / name).resolve()
    if ":" in name or not file.is_relative_to(folder):
        raise PlanspaceError(f"{path} refers to {name!r}, outside its folder; copy it beside the model.")
    return file


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
    """Takes a joint out, with the actuators and sensors on it, and keyframes, which would no longer fit."""
    for key in list(spec.keys):
        spec.delete(key)
    dropped = [a.name for a in spec.actuators if a.target == joint]
    for actuator in [a for a in spec.actuators if a.target == joint]:
        spec.delete(actuator)
    on_it = {(mujoco.mjtObj.mjOBJ_JOINT, joint)} | {(mujoco.mjtObj.mjOBJ_ACTUATOR, a) for a in dropped}
    for sensor in [s for s in spec.sensors if (s.objtype, s.objname) in on_it]:
        spec.delete(sensor)
    spec.delete(spec.joint(joint))
