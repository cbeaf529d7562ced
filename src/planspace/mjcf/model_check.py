"""Checks of a model's text and of the headers of its files, made before MuJoCo reads them."""

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable
from pathlib import Path

from planspace.errors import PlanspaceError
from planspace.mjcf.model_budget import CELLS, MAX_DEPTH, MAX_TOTALS, check_budget

MAX_ASSET_BYTES = 64 << 20
"""Size of one file."""
MAX_ASSETS_BYTES = 256 << 20
"""Total size of a model's files; a file that is referred to twice counts twice."""
HEAD_BYTES = 84
"""Bytes of a file that hold its header."""
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


def check_assets(files: Iterable[tuple[str, bytes]], where: str) -> None:
    """Check the sizes of mesh and image files, as stored and as declared in their headers.

    Args:
        files: path and content of each file; one that the model refers to twice comes twice.
        where: the model's name, for messages.

    Raises:
        PlanspaceError: a file does not have its declared size, or one or all together are too large.
    """
    sizes = pixels = 0
    for name, data in files:
        wanted = _DECLARED_SIZE.get(Path(name).suffix.lower(), lambda _: None)(data[:HEAD_BYTES])
        if wanted is not None and wanted != len(data):
            raise PlanspaceError(
                f"{where}: {name} is damaged: it has {len(data)} bytes, its header declares {wanted}."
            )
        sizes, pixels = sizes + len(data), pixels + _num_pixels(data[:HEAD_BYTES])
        if pixels > MAX_TOTALS[CELLS]:
            raise PlanspaceError(
                f"{where} refers to images of {pixels} pixels, including {name}; the limit is "
                f"{MAX_TOTALS[CELLS]}."
            )
        if sizes > MAX_ASSETS_BYTES:
            raise PlanspaceError(
                f"{where} refers to files of {sizes} bytes, including {name}; the limit is "
                f"{MAX_ASSETS_BYTES}."
            )


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
