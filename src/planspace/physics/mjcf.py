"""Model files: read without leaving their folder, made into one text, joints held."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco

from planspace.errors import PlanspaceError, unknown
from planspace.store import read_bytes

MAX_MODEL_BYTES = 16 << 20


def read_model(path: Path, joints: Sequence[str] | None = None) -> str:
    """Reads a model file as one self-contained MJCF text.

    Args:
        path: the MJCF file; includes are merged into the text.
        joints: the joints that are to move. The others are held where the model puts them: they are taken
            out, with the actuators and sensors that stand on them. None keeps all.

    Raises:
        PlanspaceError: it cannot be read or does not compile (with MuJoCo's message, which has the line), or
            it refers to a file outside its folder, or to meshes and textures in files.
        UsageError: a joint is not in the model.
    """
    text = read_text(path)
    includes = [file for file in _referred_files(path, text, {path.resolve()})]
    try:
        spec = mujoco.MjSpec.from_file(str(path)) if includes else mujoco.MjSpec.from_string(text)
        known = [joint.name for joint in spec.joints]
        for name in joints or ():
            if name not in known:
                raise unknown("joint", name, known)
        held = [name for name in known if joints is not None and name not in joints]
        if not includes and not held:
            spec.compile()
            return text
        for name in held:
            _hold(spec, name)
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


def _referred_files(path: Path, text: str, seen: set[Path]) -> Iterator[Path]:
    """The files a model includes, directly or not; refuses what lies outside the model's folder."""
    folder = path.parent.resolve()
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise PlanspaceError(f"{path} is not well-formed XML: {error}.") from error
    for element in root.iter():
        name = element.get("file")
        if name is None:
            continue
        file = (folder / name).resolve()
        if "://" in name or name.startswith("file:") or not file.is_relative_to(folder):
            raise PlanspaceError(f"{path} refers to {name!r}, outside its folder; copy it beside the model.")
        if element.tag != "include":
            raise PlanspaceError(
                f"{path} refers to {name!r}: a dataset holds its whole model as text, so a {element.tag} in "
                "a file is not supported; use geoms, or write the vertices into the model."
            )
        if file in seen:
            raise PlanspaceError(f"{path} includes {name!r} twice, or in a circle.")
        seen.add(file)
        yield file
        yield from _referred_files(folder / name, read_text(file), seen)


def _hold(spec: mujoco.MjSpec, joint: str) -> None:
    for actuator in [a for a in spec.actuators if a.target == joint]:
        spec.delete(actuator)
    on_joint = mujoco.mjtObj.mjOBJ_JOINT
    for sensor in [s for s in spec.sensors if s.objtype == on_joint and s.objname == joint]:
        spec.delete(sensor)
    spec.delete(spec.joint(joint))
