"""The joints of a model without its shapes: names, kinds and order, when its meshes do not exist here."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable

from planspace.errors import PlanspaceError
from planspace.mjcf.model_check import parse_model

COMPILER = ("angle", "autolimits", "eulerseq")
"""Attributes of `compiler` that joints depend on."""
ACTUATORS = {
    *("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle", "dcmotor"),
}
GENERATED = {"include", "attach", "replicate", "composite", "flexcomp"}
"""Elements that can contain joints that are not in the text."""
BODY = {"body", "joint", "freejoint", "frame"}
INERTIA = {"pos": "0 0 0", "mass": "1", "diaginertia": "1 1 1"}
"""Any inertia that compiles; the dynamics of a skeleton mean nothing."""


def skeleton(text: str, where: str) -> str:
    """Return the MJCF text of a model that has the same joints, limits and joint actuators, and no shapes.

    No file is read, so this also works for a model whose meshes are missing.

    Args:
        text: the MJCF text of the model.
        where: its name, for messages.

    Raises:
        PlanspaceError: the text is not MJCF, or its joints are partly in other files.
    """
    root = parse_model(text, where)
    if found := next((e.tag for e in root.iter() if e.tag in GENERATED), None):
        raise PlanspaceError(f"{where} has an element <{found}>, so its text does not contain all joints.")
    bare = ElementTree.Element("mujoco")
    for compiler in root.findall("compiler"):
        kept = {name: compiler.attrib[name] for name in COMPILER if name in compiler.attrib}
        ElementTree.SubElement(bare, "compiler", kept)
    for default in root.findall("default"):
        bare.append(_filtered(default, {"default", "joint", *ACTUATORS}))
    world = ElementTree.SubElement(bare, "worldbody")
    for element in root.findall("worldbody"):
        world.extend(_filtered(element, BODY))
    for body in world.iter("body"):
        body.attrib = {name: body.attrib[name] for name in ("name", "childclass") if name in body.attrib}
        body.insert(0, ElementTree.Element("inertial", INERTIA))
    tendons = [e for section in root.findall("tendon") for e in section.findall("fixed")]
    _add_section(bare, "tendon", tendons)
    names = {tendon.get("name") for tendon in tendons}
    equalities = [e for section in root.findall("equality") for e in section]
    _add_section(bare, "equality", (e for e in equalities if e.tag == "joint"))
    actuators = [e for section in root.findall("actuator") for e in section if e.tag in ACTUATORS]
    _add_section(bare, "actuator", (e for e in actuators if "joint" in e.attrib or e.get("tendon") in names))
    return ElementTree.tostring(bare, encoding="unicode")


def refers_to_files(text: str, where: str) -> str:
    """Return the first mesh or other file that the text of a model refers to; empty if there is none.

    Pictures are left out, because they are replaced by a plain colour.

    Raises:
        PlanspaceError: the text is not MJCF.
    """
    elements = (e for e in parse_model(text, where).iter() if e.tag != "texture")
    return next((e.attrib["file"] for e in elements if "file" in e.attrib), "")


def _filtered(element: ElementTree.Element, tags: set[str]) -> ElementTree.Element:
    """A copy of an element with those of its descendants that have certain tags."""
    copy = ElementTree.Element(element.tag, element.attrib)
    copy.extend(_filtered(child, tags) for child in element if child.tag in tags)
    return copy


def _add_section(root: ElementTree.Element, tag: str, elements: Iterable[ElementTree.Element]) -> None:
    ElementTree.SubElement(root, tag).extend(elements)
