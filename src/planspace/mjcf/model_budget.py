"""Limits on what a model may request, checked in its text before MuJoCo compiles it.

A few characters of MJCF can request any amount of memory or time: nested copies, textures, sensors, solver
iterations. The limits are far above what any robot needs. Times and sizes are those of MuJoCo 3.17.
"""

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

from planspace.errors import PlanspaceError

MAX_DEPTH = 200
"""Levels of nested elements."""
PARTS, POINTS, LINKS = "replicated elements", "points of flexible bodies", "links of composite bodies"
CELLS, NUMBERS = "cells", "numbers"
MAX_TOTALS = {
    PARTS: 5_000,  # made by `replicate`; the compile time grows with their square, to 5 s
    POINTS: 5_000,  # likewise, to 3 s
    LINKS: 500,  # a composite body is a chain; the compile time grows with their cube, to 4 s
    CELLS: 1 << 26,  # pixels, points of height fields, and memory of meshes made by MuJoCo
    NUMBERS: 1_000_000,  # everything else; most of them exist in every simulation
}
"""What a whole model may request of each kind."""
COUNTS = ("num", "dim", "actdim", "nsample", "nuserdata")
"""Attributes that hold a count, for any element. That of a `numeric` is called `size`."""
INHERITED = {*COUNTS, "width", "height", "resolution"}
"""Attributes that an element may inherit from a default."""
AREAS = {
    "hfield": ("nrow", "ncol"),
    "camera": ("resolution",),
    "global": ("offwidth", "offheight"),
    "quality": ("shadowsize", "shadowsize"),
}
"""Element to the attributes that are the sides of an area."""
CELLS_PER_POINT = 200
"""Cells for each point of a mesh made by MuJoCo, whose hull takes 1.5 kB per point."""
LIMITS = {
    "iterations": 10_000,
    "ls_iterations": 10_000,
    "noslip_iterations": 10_000,
    "ccd_iterations": 10_000,
    "sdf_iterations": 10_000,
    "sdf_initpoints": 10_000,
    "nkey": 10_000,
    "njmax": 10_000,
    "nconmax": 10_000,
    "numslices": 1_000,
    "numstacks": 1_000,
    "numquads": 1_000,
    "offsamples": 1_000,
}
"""Largest values of attributes, for any element."""
SIZE_NAMES = re.compile("num|count|dim|iter|sample|resol|size|width|height|depth|^n(?!ame)")
"""Names of attributes that hold a size, in this or a later MuJoCo: at most `MAX_TOTALS[NUMBERS]` each."""
TIME_STEP_RANGE_S = 1e-6, 1.0
"""Bounds of the time step; no robot is simulated with a shorter or longer one."""
MAX_LENGTH_STEPS = 100_000
"""Steps that MuJoCo may simulate to find the length range of an actuator while it compiles."""
MAX_MEMORY_MB = 1024
"""Memory that a model may reserve for the solver."""
MEMORY = {"memory", "nstack"}
MEGABYTES = {"": 1 / (1 << 20), "K": 1 / 1024, "M": 1.0, "G": 1024.0, "T": 1024.0**2, "P": 1024.0**3}
EXPLICIT_TYPES = ("direct", "mesh", "gmsh")
"""Types of flexible bodies whose points are listed in the model or in a file."""


def check_budget(root: ElementTree.Element, where: str) -> None:
    """Reject a model that requests more than any robot needs.

    Args:
        root: the model; included files are children of their `include` elements.
        where: its name, for messages.

    Raises:
        PlanspaceError: the model requests too much; the message names the element.
    """
    totals = dict.fromkeys(MAX_TOTALS, 0.0)
    num_elements = num_per_element = most_user_numbers = 0.0
    model = _Requests(root, where)
    for element, copies in _with_copies(root, 1.0, where):
        _check_limits(element, where)
        for kind, number in model.of(element):
            totals[kind] += copies * number
            num_elements += copies * number if kind in (POINTS, LINKS) else 0.0
        num_elements += copies
        totals[PARTS] += copies if copies > 1 else 0.0
        sizes = [element.get(name) for name in element.attrib if name.startswith("nuser")]
        num_per_element += sum(_product(size, where) for size in sizes)
        num_per_element += _product(element.get("nkey"), where) + (element.tag == "key")
        most_user_numbers = max(most_user_numbers, len(element.get("user", "").split()))
        numbers = totals[NUMBERS] + (num_per_element + most_user_numbers) * num_elements
        for kind, number in (totals | {NUMBERS: numbers}).items():
            if number > MAX_TOTALS[kind]:
                raise PlanspaceError(
                    f"{where} requests {number:.3g} {kind} at <{element.tag}>; the limit is "
                    f"{MAX_TOTALS[kind]}."
                )


class _Requests:
    """What each element of a model requests; a missing attribute counts as its largest default."""

    def __init__(self, root: ElementTree.Element, where: str):
        self._where = where
        self._defaults: dict[str, str] = {}
        for default in root.iter("default"):
            for name, text in ((n, t) for element in default.iter() for n, t in element.attrib.items()):
                if name in INHERITED and self._size(text) >= self._size(self._defaults.get(name)):
                    self._defaults[name] = text
        self._pixels = max((self._get(camera, "resolution") for camera in root.iter("camera")), default=0.0)

    def of(self, element: ElementTree.Element) -> Iterator[tuple[str, float]]:
        """Kinds and numbers that an element requests."""
        tag, get = element.tag, self._get
        for name in COUNTS:
            yield NUMBERS, get(element, name)
        if tag in AREAS:
            yield CELLS, math.prod(get(element, name) for name in AREAS[tag])
        if tag == "texture":
            width, height = get(element, "width"), get(element, "height")
            is_flat = element.get("type", "cube") == "2d"
            yield CELLS, width * (height if is_flat else max(height, 6 * width))  # a cube has six sides
        elif tag == "mesh":
            side = max(map(self._size, element.get("params", "0").split()), default=0.0)
            yield CELLS, CELLS_PER_POINT * side**2
        elif tag == "composite":
            yield LINKS, self._size(element.get("count"))
        elif tag == "flexcomp":
            yield POINTS, self._points(element) + self._size(element.get("cellcount"))
        elif tag == "numeric":
            yield NUMBERS, self._size(element.get("size"))
        elif tag == "rangefinder" and "camera" in element.attrib:
            yield NUMBERS, self._pixels * max(1, len(element.get("data", "").split()))

    def _points(self, element: ElementTree.Element) -> float:
        if element.get("type", "grid") in EXPLICIT_TYPES:
            return len(element.get("point", "").split()) / 3
        return self._size(element.get("count")) or 10.0**3  # MuJoCo's default

    def _get(self, element: ElementTree.Element, name: str) -> float:
        return self._size(element.get(name)) or self._size(self._defaults.get(name))

    def _size(self, text: str | None) -> float:
        return _product(text, self._where)


def _check_limits(element: ElementTree.Element, where: str) -> None:
    tag = element.tag
    for name, text in element.attrib.items():
        if tag == "size" and name in MEMORY:
            if _megabytes(text, where) > MAX_MEMORY_MB:
                raise PlanspaceError(f"{where} reserves more than {MAX_MEMORY_MB} MB with {name}.")
        elif name in LIMITS and _product(text, where) > LIMITS[name]:
            raise PlanspaceError(f"{where} has {name}={text!r:.40}; the limit is {LIMITS[name]}.")
        elif SIZE_NAMES.search(name) and _largest(text) > MAX_TOTALS[NUMBERS]:
            raise PlanspaceError(
                f"{where} has {tag} {name}={text!r:.40}; the limit is {MAX_TOTALS[NUMBERS]}."
            )
    if tag == "option" and "timestep" in element.attrib:
        least, most = TIME_STEP_RANGE_S
        if not least <= _number(element.attrib["timestep"], where) <= most:
            raise PlanspaceError(
                f"{where} has timestep={element.attrib['timestep']!r:.40}; it must be between {least:g} s "
                f"and {most:g} s."
            )
    if tag == "lengthrange":
        total, step = (
            _number(element.get(n, d), where) for n, d in (("inttotal", "10"), ("timestep", ".01"))
        )
        if not (step > 0 and total / step <= MAX_LENGTH_STEPS):
            raise PlanspaceError(f"{where} has a lengthrange of more than {MAX_LENGTH_STEPS} steps.")


def _with_copies(
    element: ElementTree.Element, copies: float, where: str, depth: int = 1
) -> Iterator[tuple[ElementTree.Element, float]]:
    """Every element, and how many copies of it the compiled model has."""
    if depth > MAX_DEPTH:
        raise PlanspaceError(f"{where} has elements nested more than {MAX_DEPTH} levels deep.")
    yield element, copies
    if element.tag == "replicate":
        copies *= max(1.0, _product(element.get("count"), where))
    for child in element:
        yield from _with_copies(child, copies, where, depth + 1)


def _product(text: str | None, where: str) -> float:
    """Product of the numbers in a text, each at least 1; 0 if there are none."""
    numbers = [max(1.0, abs(_number(number, where))) for number in (text or "").split()]
    return math.prod(numbers) if numbers else 0.0


def _largest(text: str) -> float:
    """Largest absolute value among the first words of a text that are numbers, or 0."""
    largest = 0.0
    for word in text.split(None, 4)[:4]:
        try:
            largest = max(largest, abs(float(word)))
        except ValueError:
            continue
    return largest


def _number(text: str, where: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise PlanspaceError(f"{where} has {text[:40]!r} where a number is expected.")
    return number


def _megabytes(text: str, where: str) -> float:
    unit = text[-1:].upper() if text[-1:].isalpha() else ""
    if unit not in MEGABYTES:
        raise PlanspaceError(f"{where} has {text[:40]!r} where an amount of memory is expected.")
    return _number(text[: len(text) - len(unit)], where) * MEGABYTES[unit]
