"""How much a model asks for, counted over all its text before MuJoCo sees it.

A few characters of MJCF can ask for any amount of memory or time: copies of copies, pictures, sensors,
iterations. The bounds lie far above any robot's. Times and sizes are those of MuJoCo 3.17.
"""

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

from planspace.errors import PlanspaceError

MAX_DEPTH = 200
"""Elements within elements."""
PARTS, POINTS, LINKS = "parts, multiplied", "points of flexible bodies", "links of composite bodies"
CELLS, NUMBERS = "cells", "numbers"
MOST = {
    PARTS: 5_000,  # by replicate; time grows with their square, to 5 s
    POINTS: 5_000,  # likewise, to 3 s
    LINKS: 500,  # of composite bodies, which are chains; time grows with their cube, to 4 s
    CELLS: 1 << 26,  # pixels, points of height fields, and of meshes made by MuJoCo, each of which is many
    NUMBERS: 1_000_000,  # of all other kinds, most of which every simulation has
}
"""What a whole model may ask for of each kind."""
COUNTS = ("num", "dim", "actdim", "nsample", "nuserdata")
"""Attributes that are numbers of numbers, of whatever element; a numeric's is called size."""
INHERITED = {*COUNTS, "width", "height", "resolution"}
"""What an element may take from a default."""
AREAS = {
    "hfield": ("nrow", "ncol"),
    "camera": ("resolution",),
    "global": ("offwidth", "offheight"),
    "quality": ("shadowsize", "shadowsize"),
}
"""Attributes that are the sides of an area."""
CELLS_A_POINT = 200
"""Of a mesh made by MuJoCo: its hull takes 1.5 kB a point."""
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
"""Most that attributes may be, of whatever element."""
SIZE_NAMES = re.compile("num|count|dim|iter|sample|resol|size|width|height|depth|^n(?!ame)")
"""Names that mean a size, now or in another MuJoCo: none is more than `MOST[NUMBERS]`."""
STEP_S = 1e-6, 1.0
"""Bounds of the time step; no robot is simulated with a longer or shorter one."""
MAX_LENGTH_STEPS = 100_000
"""Steps in which MuJoCo may look for the range of an actuator's length while it compiles."""
MAX_MEMORY_MB = 1024
"""What a model may reserve for the solver."""
MEMORY = {"memory", "nstack"}
MEGABYTES = {"": 1 / (1 << 20), "K": 1 / 1024, "M": 1.0, "G": 1024.0, "T": 1024.0**2, "P": 1024.0**3}
WRITTEN_OUT = ("direct", "mesh", "gmsh")
"""Kinds of flexible bodies whose points stand in the text or in a file."""


def check_budget(root: ElementTree.Element, where: str) -> None:
    """Refuses a model that asks for more than any robot needs.

    Args:
        root: the model; what it includes stands within its `include` elements.
        where: its name, for messages.

    Raises:
        PlanspaceError: it asks for too much, by the element that is named.
    """
    asked = dict.fromkeys(MOST, 0.0)
    elements = of_every = longest = 0.0
    model = _Model(root, where)
    for element, times in _multiplied(root, 1.0, where):
        _check_limits(element, where)
        for kind, number in model.asked(element):
            asked[kind] += times * number
            elements += times * number if kind in (POINTS, LINKS) else 0.0
        elements += times
        asked[PARTS] += times if times > 1 else 0.0
        of_every += sum(_product(element.get(name), where) for name in element.attrib if name[:5] == "nuser")
        of_every += _product(element.get("nkey"), where) + (element.tag == "key")
        longest = max(longest, len(element.get("user", "").split()))
        total = asked | {NUMBERS: asked[NUMBERS] + (of_every + longest) * elements}
        for kind, number in total.items():
            if number > MOST[kind]:
                raise PlanspaceError(
                    f"{where} asks for {number:.3g} {kind}, by <{element.tag}>; {MOST[kind]} may be."
                )


class _Model:
    """What each element of a model asks for; where it does not say, by the largest default."""

    def __init__(self, root: ElementTree.Element, where: str):
        self._where = where
        self._defaults: dict[str, str] = {}
        for default in root.iter("default"):
            for name, text in ((n, t) for element in default.iter() for n, t in element.attrib.items()):
                if name in INHERITED and self._size(text) >= self._size(self._defaults.get(name)):
                    self._defaults[name] = text
        self._view = max((self._get(camera, "resolution") for camera in root.iter("camera")), default=0.0)

    def asked(self, element: ElementTree.Element) -> Iterator[tuple[str, float]]:
        """Kinds and numbers."""
        tag, get = element.tag, self._get
        for name in COUNTS:
            yield NUMBERS, get(element, name)
        if tag in AREAS:
            yield CELLS, math.prod(get(element, name) for name in AREAS[tag])
        if tag == "texture":
            width, height = get(element, "width"), get(element, "height")
            flat = element.get("type", "cube") == "2d"
            yield CELLS, width * (height if flat else max(height, 6 * width))  # a cube has six sides
        elif tag == "mesh":
            side = max(map(self._size, element.get("params", "0").split()), default=0.0)
            yield CELLS, CELLS_A_POINT * side**2
        elif tag == "composite":
            yield LINKS, self._size(element.get("count"))
        elif tag == "flexcomp":
            yield POINTS, self._points(element) + self._size(element.get("cellcount"))
        elif tag == "numeric":
            yield NUMBERS, self._size(element.get("size"))
        elif tag == "rangefinder" and "camera" in element.attrib:
            yield NUMBERS, self._view * max(1, len(element.get("data", "").split()))

    def _points(self, element: ElementTree.Element) -> float:
        if element.get("type", "grid") in WRITTEN_OUT:
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
                raise PlanspaceError(f"{where} reserves more than {MAX_MEMORY_MB} MB, by {name}.")
        elif name in LIMITS and _product(text, where) > LIMITS[name]:
            raise PlanspaceError(f"{where} has {name}={text!r:.40}; at most {LIMITS[name]} may be.")
        elif SIZE_NAMES.search(name) and _largest(text) > MOST[NUMBERS]:
            raise PlanspaceError(f"{where} has {tag} {name}={text!r:.40}: too much.")
    if tag == "option" and "timestep" in element.attrib:
        least, most = STEP_S
        if not least <= _number(element.attrib["timestep"], where) <= most:
            raise PlanspaceError(
                f"{where} has timestep={element.attrib['timestep']!r:.40}; a time step is at least {least:g} "
                f"s and at most {most:g} s."
            )
    if tag == "lengthrange":
        total, step = (
            _number(element.get(n, d), where) for n, d in (("inttotal", "10"), ("timestep", ".01"))
        )
        if not (step > 0 and total / step <= MAX_LENGTH_STEPS):
            raise PlanspaceError(f"{where} has a lengthrange of more than {MAX_LENGTH_STEPS} steps.")


def _multiplied(
    element: ElementTree.Element, times: float, where: str, depth: int = 1
) -> Iterator[tuple[ElementTree.Element, float]]:
    """Every element, and how many of it there will be."""
    if depth > MAX_DEPTH:
        raise PlanspaceError(f"{where} has elements more than {MAX_DEPTH} deep.")
    yield element, times
    if element.tag == "replicate":
        times *= max(1.0, _product(element.get("count"), where))
    for child in element:
        yield from _multiplied(child, times, where, depth + 1)


def _product(text: str | None, where: str) -> float:
    """Of the numbers in a text, each at least 1; 0 where there is none."""
    numbers = [max(1.0, abs(_number(number, where))) for number in (text or "").split()]
    return math.prod(numbers) if numbers else 0.0


def _largest(text: str) -> float:
    """The largest of the first numbers in a text, which may hold none."""
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
        raise PlanspaceError(f"{where} has {text[:40]!r} where a number belongs.")
    return number


def _megabytes(text: str, where: str) -> float:
    unit = text[-1:].upper() if text[-1:].isalpha() else ""
    if unit not in MEGABYTES:
        raise PlanspaceError(f"{where} has {text[:40]!r} where an amount of memory belongs.")
    return _number(text[: len(text) - len(unit)], where) * MEGABYTES[unit]
