"""What may be in a model, checked in its text and in the headers of its files before MuJoCo sees them."""

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable
from pathlib import Path

from planspace.errors import PlanspaceError
from planspace.mjcf.model_budget import CELLS, MAX_DEPTH, MOST, check_budget
from planspace.storage.checks import check_file, explain_read

MAX_ASSET_BYTES = 64 << 20
"""Of a file."""
MAX_ASSETS_BYTES = 256 << 20
"""Of all files of a model; one that is referred to twice counts twice."""
FORBIDDEN = {"plugin": "a plugin, whose own state is no part of a robot's", "extension": "extensions"}
FILE_ATTRIBUTES = {"file", *(f"file{side}" for side in ("right", "left", "up", "down", "front", "back"))}
"""Attributes that name a file; the last six are a cube texture's."""


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
    for element in root.iter():
        if element.tag in FORBIDDEN:
            raise PlanspaceError(
                f"{where} has {FORBIDDEN[element.tag]}: planspace does not take such models."
            )
    check_budget(root, where)
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


def check_assets(paths: Iterable[Path], where: str) -> None:
    """Checks meshes and pictures by their headers: that each is as large as it says, and that all are little.

    Args:
        paths: the files, each as often as the model refers to it.
        where: the model's name, for messages.

    Raises:
        PlanspaceError: one is not, or is missing; or all together are too large.
    """
    sizes = pixels = 0
    for path in paths:
        size, head = _read_head(path)
        wanted = _SIZES.get(path.suffix.lower(), lambda _: None)(head)
        if wanted is not None and wanted != size:
            raise PlanspaceError(f"{path} has {size} bytes, its header asks for {wanted}: it is damaged.")
        sizes, pixels = sizes + size, pixels + _pixels(head)
        if pixels > MOST[CELLS]:
            raise PlanspaceError(
                f"{where} has pictures of {pixels} pixels, with {path}; {MOST[CELLS]} may be."
            )
        if sizes > MAX_ASSETS_BYTES:
            raise PlanspaceError(
                f"{where} has files of {sizes} bytes, with {path}; {MAX_ASSETS_BYTES} may be."
            )


def _read_head(path: Path) -> tuple[int, bytes]:
    check_file(path, most=MAX_ASSET_BYTES, may_be_link=True)  # the model's folder was seen to hold it
    with explain_read(path), open(path, "rb") as file:
        return path.stat().st_size, file.read(84)


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
