"""Checks of a model's text and of the headers of its files, made before MuJoCo reads them."""

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable
from pathlib import Path

from planspace.errors import PlanspaceError
from planspace.mjcf.model_budget import CELLS, MAX_DEPTH, MAX_TOTALS, check_budget
from planspace.storage.checks import check_file, explain_read

MAX_ASSET_BYTES = 64 << 20
"""Size of one file."""
MAX_ASSETS_BYTES = 256 << 20
"""Total size of a model's files; a file that is referred to twice counts twice."""
FORBIDDEN = ("plugin", "extension")
"""Elements that are not supported: a plugin has a state of its own, which is not part of the robot's."""
FILE_ATTRIBUTES = {"file", *(f"file{side}" for side in ("right", "left", "up", "down", "front", "back"))}
"""Attributes that name a file; the last six belong to cube textures."""


def parse_model(text: str, where: str) -> ElementTree.Element:
    """Parse MJCF and check what it requests.

    Args:
        text: the file's text.
        where: its name, for messages.

    Raises:
        PlanspaceError: the text is not MJCF, or requests something that no robot needs.
    """
    if "<!" in text.replace("<!--", ""):
        raise PlanspaceError(f"{where} defines entities or a document type; a model needs neither.")
    try:
        parser = ElementTree.XMLParser(target=_BoundedTreeBuilder(where))
        root = ElementTree.fromstring(text, parser)
    except ElementTree.ParseError as error:
        raise PlanspaceError(f"{where} is not well-formed XML: {error}.") from error
    if root.tag not in ("mujoco", "mujocoinclude"):
        raise PlanspaceError(f"{where} is not an MJCF model: its root element is <{root.tag[:80]}>.")
    for element in root.iter():
        if element.tag in FORBIDDEN:
            raise PlanspaceError(
                f"{where} has an element <{element.tag}>; planspace does not support plugins and extensions."
            )
    check_budget(root, where)
    return root


def check_self_contained(text: str) -> None:
    """Check that a model refers to no file and passes `parse_model`.

    Raises:
        PlanspaceError: the model does not pass.
    """
    for element in parse_model(text, "the model").iter():
        if element.tag == "include" or FILE_ATTRIBUTES & element.attrib.keys():
            name = next((element.attrib[key] for key in FILE_ATTRIBUTES & element.attrib.keys()), "")
            raise PlanspaceError(
                f"the model refers to the file {name[:80]!r}; a model inside a dataset or problem must be "
                "self-contained."
            )


def check_assets(paths: Iterable[Path], where: str) -> None:
    """Check the sizes of mesh and image files, as stored and as declared in their headers.

    Args:
        paths: the files; one that the model refers to twice is listed twice.
        where: the model's name, for messages.

    Raises:
        PlanspaceError: a file is missing or does not have its declared size, or all together are too large.
    """
    sizes = pixels = 0
    for path in paths:
        size, head = _read_head(path)
        wanted = _DECLARED_SIZE.get(path.suffix.lower(), lambda _: None)(head)
        if wanted is not None and wanted != size:
            raise PlanspaceError(f"{path} is damaged: it has {size} bytes, its header declares {wanted}.")
        sizes, pixels = sizes + size, pixels + _num_pixels(head)
        if pixels > MAX_TOTALS[CELLS]:
            raise PlanspaceError(
                f"{where} refers to images of {pixels} pixels, including {path}; the limit is "
                f"{MAX_TOTALS[CELLS]}."
            )
        if sizes > MAX_ASSETS_BYTES:
            raise PlanspaceError(
                f"{where} refers to files of {sizes} bytes, including {path}; the limit is "
                f"{MAX_ASSETS_BYTES}."
            )


def _read_head(path: Path) -> tuple[int, bytes]:
    check_file(path, most=MAX_ASSET_BYTES, may_be_link=True)  # it lies in the model's folder
    with explain_read(path), open(path, "rb") as file:
        return path.stat().st_size, file.read(84)


class _BoundedTreeBuilder(ElementTree.TreeBuilder):
    """Builds a tree of bounded depth."""

    def __init__(self, where: str):
        super().__init__()
        self._depth, self._where = 0, where

    def start(self, tag: str, attrs: dict[str, str]) -> ElementTree.Element:  # pyright: ignore
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise PlanspaceError(f"{self._where} has elements nested more than {MAX_DEPTH} levels deep.")
        return super().start(tag, attrs)

    def end(self, tag: str) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)


def _stl_size(head: bytes) -> int | None:
    if head.startswith(b"solid") or len(head) < 84:
        return None  # text, which MuJoCo rejects, or too short
    return 84 + 50 * struct.unpack("<I", head[80:84])[0]


def _msh_size(head: bytes) -> int | None:
    if len(head) < 16:
        return None
    vertices, normals, texcoords, faces = struct.unpack("<4i", head[:16])
    return 16 + 12 * (vertices + normals + faces) + 8 * texcoords


def _num_pixels(head: bytes) -> int:
    if head[:8] != b"\x89PNG\r\n\x1a\n" or len(head) < 24:
        return 0
    width, height = struct.unpack(">2I", head[16:24])
    return width * height


_DECLARED_SIZE: dict[str, Callable[[bytes], int | None]] = {".stl": _stl_size, ".msh": _msh_size}
