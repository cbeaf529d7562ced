"""What a model may ask for, checked in its text before MuJoCo sees it.

A few characters of MJCF can ask for any amount of memory: copies of copies, pictures, height fields, stacks.
The bounds lie far above any robot's.
"""

import math
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path

from planspace.errors import PlanspaceError

MAX_DEPTH = 200
"""Elements within elements."""
MAX_COPIES = 100_000
"""Elements, or points of a flexible body, that counts in the text multiply to."""
MAX_CELLS = 1 << 26
"""Pixels of a picture, or points of a height field."""
MAX_NUMBER = 1_000_000
"""Any other size in the text."""
MAX_MEMORY_MB = 1024
"""What a model may reserve for the solver."""
MAX_ASSET_BYTES = 64 << 20
FORBIDDEN = {"plugin": "a plugin, whose own state is no part of a robot's", "extension": "extensions"}
FILE_ATTRIBUTES = {"file", *(f"file{side}" for side in ("right", "left", "up", "down", "front", "back"))}
"""Attributes that name a file; the last six are a cube texture's."""
COPYING = {"replicate": "count", "composite": "count", "flexcomp": "count"}
CELLS = {"texture": ("width", "height"), "hfield": ("nrow", "ncol")}
SIZES = {"size": None, "numeric": ("size",), "user": ("dim",)}
"""Elements whose numbers are sizes; None takes all attributes."""
MEMORY = {"memory", "nstack"}
MEGABYTES = {"": 1 / (1 << 20), "K": 1 / 1024, "M": 1.0, "G": 1024.0, "T": 1024.0**2, "P": 1024.0**3}


def parse_model(text: str, where: str) -> ElementTree.Element:
    """Parses MJCF and checks what it asks for.

    Args:
        text: the file's text.
        where: its name, for messages.

    Raises:
        PlanspaceError: it is no MJCF, or asks for something that no robot needs.
    """
    if "<!" in text.replace("<!--", ""):
        raise PlanspaceError(f"{where} defines entities or a document type; a model needs neither.")
    try:
        parser = ElementTree.XMLParser(target=_Shallow(where))
        root = ElementTree.fromstring(text, parser)
    except ElementTree.ParseError as error:
        raise PlanspaceError(f"{where} is not well-formed XML: {error}.") from error
    if root.tag not in ("mujoco", "mujocoinclude"):
        raise PlanspaceError(f"{where} is no MJCF model: it begins with <{root.tag[:80]}>.")
    _check(root, where)
    return root


def check_self_contained(text: str) -> None:
    """Checks that a model's text asks for no file, and for nothing else that `parse_model` refuses.

    Raises:
        PlanspaceError: it does.
    """
    for element in parse_model(text, "the model").iter():
        if element.tag == "include" or FILE_ATTRIBUTES & element.attrib.keys():
            name = next((element.attrib[key] for key in FILE_ATTRIBUTES & element.attrib.keys()), "")
            raise PlanspaceError(
                f"the model refers to the file {name[:80]!r}; a model in a dataset or a problem is whole."
            )


def check_asset(path: Path) -> None:
    """Checks a mesh or a picture by its header: that it is as large as it says, and that that is little.

    Raises:
        PlanspaceError: it is not; or it is missing.
    """
    try:
        with open(path, "rb") as file:
            size = path.stat().st_size
            head = file.read(84)
    except OSError as error:
        raise PlanspaceError(f"cannot read {path}: {error.strerror}.") from error
    if size > MAX_ASSET_BYTES:
        raise PlanspaceError(f"{path} has {size} bytes; an asset has at most {MAX_ASSET_BYTES}.")
    if _pixels(head) > MAX_CELLS:
        raise PlanspaceError(f"{path} says that it has {_pixels(head)} pixels; {MAX_CELLS} may be.")
    wanted = _SIZES.get(path.suffix.lower(), lambda _: None)(head)
    if wanted is not None and wanted != size:
        raise PlanspaceError(f"{path} has {size} bytes, its header asks for {wanted}: it is damaged.")


class _Shallow(ElementTree.TreeBuilder):
    """Builds a tree of bounded depth."""

    def __init__(self, where: str):
        super().__init__()
        self._depth, self._where = 0, where

    def start(self, tag: str, attrs: dict[str, str]) -> ElementTree.Element:  # pyright: ignore
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise PlanspaceError(f"{self._where} has elements more than {MAX_DEPTH} deep.")
        return super().start(tag, attrs)

    def end(self, tag: str) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)


def _check(root: ElementTree.Element, where: str) -> None:
    copies = 0.0
    for element, times in _multiplied(root, 1.0, where):
        tag = element.tag
        if tag in FORBIDDEN:
            raise PlanspaceError(f"{where} has {FORBIDDEN[tag]}: planspace does not take such models.")
        copies += times
        if copies > MAX_COPIES and times > 1:
            raise PlanspaceError(f"{where} multiplies its parts to more than {MAX_COPIES}, by <{tag}>.")
        if tag in CELLS:
            cells = math.prod(_number(element.get(name, "1"), where) for name in CELLS[tag])
            if cells > MAX_CELLS:
                raise PlanspaceError(f"{where} asks for a {tag} of {cells:.3g} cells; {MAX_CELLS} may be.")
        for name in SIZES.get(tag, ()) or (element.attrib if tag == "size" else ()):
            if name in MEMORY:
                if _megabytes(element.attrib[name], where) > MAX_MEMORY_MB:
                    raise PlanspaceError(f"{where} reserves more than {MAX_MEMORY_MB} MB, by {name}.")
            elif _number(element.get(name, "0"), where) > MAX_NUMBER:
                raise PlanspaceError(f"{where} has {tag} {name}={element.get(name)!r:.40}: too much.")


def _multiplied(
    element: ElementTree.Element, times: float, where: str
) -> Iterator[tuple[ElementTree.Element, float]]:
    """Every element, and how many of it there will be."""
    if element.tag in COPYING:
        counts = element.get(COPYING[element.tag], "1").split()
        times *= math.prod(max(1.0, _number(count, where)) for count in counts)
    yield element, times
    for child in element:
        yield from _multiplied(child, times, where)


def _number(text: str, where: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise PlanspaceError(f"{where} has {text[:40]!r} where a number belongs.")
    return number


def _megabytes(text: str, where: str) -> float:
    unit = text[-1:].upper() if text[-1:].isalpha() else ""
    if unit not in MEGABYTES:
        raise PlanspaceError(f"{where} has {text[:40]!r} where an amount of memory belongs.")
    return _number(text[: len(text) - len(unit)], where) * MEGABYTES[unit]


def _stl(head: bytes) -> int | None:
    if head.startswith(b"solid") or len(head) < 84:
        return None  # text, which MuJoCo refuses, or too short
    return 84 + 50 * struct.unpack("<I", head[80:84])[0]


def _msh(head: bytes) -> int | None:
    if len(head) < 16:
        return None
    vertices, normals, texcoords, faces = struct.unpack("<4i", head[:16])
    return 16 + 12 * (vertices + normals + faces) + 8 * texcoords


def _pixels(head: bytes) -> int:
    if head[:8] != b"\x89PNG\r\n\x1a\n" or len(head) < 24:
        return 0
    width, height = struct.unpack(">2I", head[16:24])
    return width * height


_SIZES: dict[str, Callable[[bytes], int | None]] = {".stl": _stl, ".msh": _msh}
