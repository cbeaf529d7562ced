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
from planspace.store import check_file, explain_read

MAX_DEPTH = 200
"""Elements within elements."""
MAX_COPIES = 100_000
"""Elements, or points of a flexible body, that counts in the text multiply to."""
MAX_FLEX = 10_000
"""Points of a flexible body, whose compilation takes long."""
MAX_MADE = 300
"""Points along a side of a mesh that MuJoCo makes itself."""
MAX_CELLS = 1 << 26
"""Pixels of all pictures and cameras, and points of all height fields."""
MAX_NUMBER = 1_000_000
"""All other sizes in the text together, those that every element has times the elements."""
MAX_ITERATIONS = 10_000
"""Of any solver, a step."""
MAX_MEMORY_MB = 1024
"""What a model may reserve for the solver."""
MAX_ASSET_BYTES = 64 << 20
FORBIDDEN = {"plugin": "a plugin, whose own state is no part of a robot's", "extension": "extensions"}
FILE_ATTRIBUTES = {"file", *(f"file{side}" for side in ("right", "left", "up", "down", "front", "back"))}
"""Attributes that name a file; the last six are a cube texture's."""
COPYING = {"replicate": "count", "composite": "count", "flexcomp": "count"}
CELLS = {
    "texture": ("width", "height"),
    "hfield": ("nrow", "ncol"),
    "camera": ("resolution",),
}
COUNTS = {"num", "actdim", "dim", "nsample", "cellcount", "maxhullvert"}
"""Attributes that are sizes, of whatever element; a numeric's is called size."""
ITERATIONS = ("iterations", "sdf_initpoints")
"""How the names end of what a step repeats."""
MEMORY = {"memory", "nstack"}
COMPILE_ERRORS = (ValueError, RuntimeError, MemoryError)
"""What MuJoCo raises at a model it does not take."""
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
    check_file(path, most=MAX_ASSET_BYTES, may_be_link=True)  # the model's folder was seen to hold it
    with explain_read(path), open(path, "rb") as file:
        size = path.stat().st_size
        head = file.read(84)
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
    elements = copies = cells = sizes = of_every = 0.0
    for element, times in _multiplied(root, 1.0, where):
        _check_element(element, times, where)
        elements += times
        copies += times if times > 1 else 0
        cells += times * _cells(element, where)
        sizes += times * _sizes(element, where)
        of_every += sum(_size(element, name, where) for name in element.attrib if name.startswith("nuser"))
        for number, most, what in (
            (copies, MAX_COPIES, "parts, multiplied"),
            (cells, MAX_CELLS, "cells"),
            (sizes + of_every * elements, MAX_NUMBER, "numbers"),
        ):
            if number > most:
                raise PlanspaceError(
                    f"{where} asks for {number:.3g} {what}, by <{element.tag}>; {most} may be."
                )


def _check_element(element: ElementTree.Element, times: float, where: str) -> None:
    tag = element.tag
    if tag in FORBIDDEN:
        raise PlanspaceError(f"{where} has {FORBIDDEN[tag]}: planspace does not take such models.")
    if tag == "flexcomp" and times > MAX_FLEX:
        raise PlanspaceError(f"{where} has a flexible body of {times:.3g} points; {MAX_FLEX} may be.")
    if tag == "mesh" and max(_numbers(element.get("params", ""), where), default=0.0) > MAX_MADE:
        raise PlanspaceError(f"{where} has a mesh made of params={element.get('params')!r:.40}: too much.")
    for name, text in element.attrib.items():
        if tag == "size" and name in MEMORY and _megabytes(text, where) > MAX_MEMORY_MB:
            raise PlanspaceError(f"{where} reserves more than {MAX_MEMORY_MB} MB, by {name}.")
        if tag == "option" and name.endswith(ITERATIONS) and _number(text, where) > MAX_ITERATIONS:
            raise PlanspaceError(f"{where} has {name}={text!r:.40}; at most {MAX_ITERATIONS} may be.")
        if tag == "option" and name == "timestep" and not _number(text, where) > 0.0:
            raise PlanspaceError(f"{where} has timestep={text!r:.40}; a time step is positive.")


def _cells(element: ElementTree.Element, where: str) -> float:
    texts = [element.attrib[name] for name in CELLS.get(element.tag, ()) if name in element.attrib]
    return math.prod(_at_least_one(" ".join(texts), where), start=1.0) if texts else 0.0


def _sizes(element: ElementTree.Element, where: str) -> float:
    names = COUNTS & element.attrib.keys()
    if element.tag == "numeric":
        names |= {"size"} & element.attrib.keys()
    if element.tag == "size":
        names |= {name for name in element.attrib if name not in MEMORY and not name.startswith("nuser")}
    return sum((_size(element, name, where) for name in names), 0.0)


def _size(element: ElementTree.Element, name: str, where: str) -> float:
    return math.prod(_at_least_one(element.attrib[name], where), start=1.0)


def _at_least_one(text: str, where: str) -> list[float]:
    return [max(1.0, number) for number in _numbers(text, where)]


def _numbers(text: str, where: str) -> list[float]:
    return [_number(number, where) for number in text.split()]


def _multiplied(
    element: ElementTree.Element, times: float, where: str
) -> Iterator[tuple[ElementTree.Element, float]]:
    """Every element, and how many of it there will be."""
    if element.tag in COPYING:
        counts = element.get(COPYING[element.tag], "1")
        times *= math.prod(_at_least_one(counts, where))
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
