"""Guesses from the names of columns: times, counters, demonstrations, units, angles and quaternions.

A guess decides only where neither the user nor the file says what a column contains. Every guess is printed.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

from planspace.demos.formats.format import Column, Kind
from planspace.physics.angles import TWO_PI

SECONDS = {
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
    "ms": 1e-3, "msec": 1e-3, "msecs": 1e-3, "millis": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "usec": 1e-6, "usecs": 1e-6, "micros": 1e-6, "microseconds": 1e-6,
    "ns": 1e-9, "nsec": 1e-9, "nsecs": 1e-9, "nanos": 1e-9, "nanoseconds": 1e-9,
    "min": 60.0, "h": 3600.0,
}  # fmt: skip
"""Units of time [s]."""
RADIANS = {"rad": 1.0, **dict.fromkeys(("deg", "degree", "degrees"), TWO_PI / 360), "turn": TWO_PI}
"""Units of angles [rad]."""
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3}
"""Units of lengths [m]."""
CONVERSIONS = {
    "rad": RADIANS,
    "m": LENGTHS,
    "rad/s": {**{f"{unit}/s": factor for unit, factor in RADIANS.items()}, "rpm": TWO_PI / 60},
    "m/s": {f"{unit}/s": factor for unit, factor in LENGTHS.items()},
}
"""For the units of a model, the units that are converted to them, and by what they are multiplied."""
EPOCHS = ((1e8, "s"), (1e11, "ms"), (1e14, "us"), (1e17, "ns"))
"""A clock that starts above a value counts since 1970, in this unit."""
_OTHER_UNITS = ("m", "mm", "cm", "km", "n", "nm", "v", "a", "hz", "kg", "m/s", "rad/s", "deg/s", "m/s^2")
_UNITS = {*SECONDS, *RADIANS, *_OTHER_UNITS}

_NUMBER = r"(_?(index|id|idx|number|no|num))?"
_TIME = re.compile(
    r"(header_|field_header_)?(time|t|timestamp|time_?stamp|stamp|clock|secs?|seconds|"
    r"(elapsed|sim|wall|ros|unix|recv|log)_?(time|stamp)|time_elapsed)"
    rf"(_({'|'.join(SECONDS)}))?"
)
_COUNTER = re.compile(
    rf"(unnamed_0|frame{_NUMBER}|frames|index|idx|row{_NUMBER}|line{_NUMBER}|steps?{_NUMBER}|time_?steps?|"
    rf"sample{_NUMBER}|(header_)?seq|iteration|iter|counter|count|task{_NUMBER})?"
)
_EPISODE = re.compile(
    rf"(episode|ep|demo|demonstration|traj|trajectory|trial|rollout|run|recording){_NUMBER}"
)
_OUTCOME = re.compile(
    r"(next_|is_)?(rewards?|dones?|success|terminated|truncated|terminals?|timeouts?|first|last|return|"
    r"discount|split)"
)
_CONTROL = re.compile(r"(control|action|ctrl)s?_?\d{1,4}_?")
_COMPASS = re.compile(r"(.*_)?(yaw|heading|azimuth|bearing)(_angle)?")
_COMPONENT = re.compile(r"(?i)(?P<stem>.*?(?:^|[^a-z0-9]|quat|orientation|q))(?P<axis>[wxyz])(?P<end>\W*)")


def split_unit(name: str) -> Column:
    """Separate the unit from a header such as `yaw [deg]` or `x (m)`."""
    match = re.fullmatch(r"(?P<name>.+?)\s*[\[(](?P<unit>[^\[\]()]+)[\])]", name)
    if match and match["unit"].strip().lower() in _UNITS:
        return Column(match["name"], match["unit"].strip())
    return Column(name)


def guess_kind(column: Column) -> Kind | None:
    """What a column contains by its name; None if the name does not tell."""
    name = _plain(column.name)
    if _TIME.fullmatch(name):
        return "time"
    if _EPISODE.fullmatch(name):
        return "episode"
    if _COUNTER.fullmatch(name) or _OUTCOME.fullmatch(name):
        return "unused"
    return "control" if _CONTROL.fullmatch(name) else None


def guess_unit(column: Column) -> Column:
    """Add the unit that the end of a name says, such as `yaw_deg` or `timestamp_ns`."""
    stem, _, unit = _plain(column.name).rpartition("_")
    if column.unit or not stem:
        return column
    if unit in SECONDS and guess_kind(column) == "time":
        return replace(column, unit=unit)
    return replace(column, unit=unit) if unit in ("rad", "deg") else column


def is_compass_angle(name: str) -> bool:
    """Whether a name says that its number is an angle on a circle: yaw, heading, azimuth or bearing."""
    plain = re.sub(r"_(rad|deg)$", "", _plain(name))
    return bool(_COMPASS.fullmatch(plain))


def is_counter(name: str) -> bool:
    """Whether a name says that a column counts rows, such as `frame_index`."""
    return bool(_COUNTER.fullmatch(_plain(name)))


def guess_quaternions(names: Sequence[str]) -> list[tuple[int, int, int, int]]:
    """Positions of w, x, y, z of each quaternion whose four columns follow each other and are named so.

    Recognises `qw, qx, qy, qz` and names that contain `quat`, `orientation` or `rot`, in the order w, x, y, z
    or x, y, z, w.
    """
    found: list[tuple[int, int, int, int]] = []
    start = 0
    while start + 4 <= len(names):
        matches = [_COMPONENT.fullmatch(name) for name in names[start : start + 4]]
        axes = "".join(m["axis"].lower() if m else "?" for m in matches)
        stems = {m["stem"].lower() for m in matches if m}
        if len(stems) == 1 and axes in ("wxyz", "xyzw") and _names_rotation(stems.pop()):
            w = axes.index("w")
            x = axes.index("x")
            found.append((start + w, start + x, start + x + 1, start + x + 2))
            start += 4
        else:
            start += 1
    return found


def _names_rotation(stem: str) -> bool:
    return bool(re.search(r"quat|orient|rot|(^|[^a-z])q$", stem))


def _plain(name: str) -> str:
    """A name in lower case, with one underscore between its words."""
    words = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name)
    return re.sub(r"[\W_]+", "_", words.lower()).strip("_")
