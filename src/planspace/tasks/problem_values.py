"""Single values of a problem file: each function reads one kind, or raises ValueError or TypeError."""

import math
from collections.abc import Callable
from typing import Any, Literal

from planspace.errors import unknown
from planspace.mjcf.compile import GeomPairs
from planspace.mjcf.source import Hold
from planspace.tasks.problem import Box
from planspace.tasks.strict_yaml import short

MAX_SETTING = 100_000
"""Largest setting of a planner in a file; larger ones must be given on the command line."""

REQUIRED = object()


def read(settings: dict[str, Any], key: str, reader: Callable[[Any], Any], default: Any = REQUIRED) -> Any:
    """Return one value of a file, or its default; an error names its key.

    Raises:
        ValueError: the value cannot be read.
    """
    if key not in settings and default is not REQUIRED:
        return default
    try:
        return reader(settings[key])
    except KeyError as error:
        raise ValueError(f"{key}: the key {error} is missing") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ValueError(f"{key}: {error}") from error


def box(value: Any) -> Box:
    """Read a box: a state, or `low` and `high`."""
    low, high = _sides(value) if isinstance(value, dict) else (numbers(value), numbers(value))
    return Box(low, high)


def goal(value: Any) -> tuple[Box, bool]:
    """Read the box of a goal, and whether each plan's goal is drawn from it."""
    if not isinstance(value, dict):
        return box(value), False
    return box({k: v for k, v in value.items() if k != "random"}), flag(value.get("random", False))


def _sides(value: dict[str, Any]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    for key in value:
        if key not in ("low", "high"):
            raise ValueError(str(unknown("key of a box", str(key), ["low", "high"])))
    low, high = numbers(value["low"]), numbers(value["high"])
    if len(low) != len(high):
        raise ValueError(f"low has {len(low)} numbers and high has {len(high)}; they must have as many.")
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise ValueError(f"a box needs low <= high, number by number; got {short(value)}.")
    return low, high


def position_bounds(value: Any) -> tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...]:
    """Read a box for each of some joints."""
    return tuple((str(name), *_sides(box)) for name, box in value.items())


def body_features(value: Any) -> tuple[tuple[str, float], ...]:
    """Read bodies with the weights of their positions."""
    if not isinstance(value, dict):
        raise TypeError(f"expected bodies with their weights, got {short(value)}")
    return tuple((text(body), positive(weight)) for body, weight in value.items())


def contacts(value: Any) -> Literal["none", "all"] | GeomPairs:
    """Read which contacts are forbidden."""
    if value in ("none", "all"):
        return value
    pairs = tuple(names(pair) for pair in value) if isinstance(value, list) else ()
    if not pairs or any(len(pair) != 2 for pair in pairs):
        raise ValueError("expected none, all, or a list of pairs of geoms")
    return pairs  # pyright: ignore[reportReturnType]


def settings(value: Any) -> tuple[tuple[str, Any], ...]:
    """Read the settings of a planner."""
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise TypeError(f"expected keys and values, got {short(value)}")
    for key, setting in value.items():
        if not isinstance(setting, str) and not abs(_number(setting)) <= MAX_SETTING:
            raise ValueError(f"{key} must be at most {MAX_SETTING}, got {short(setting)}")
    return tuple(sorted(value.items()))


def cost(value: Any) -> Literal["duration", "effort"]:
    """Read the name of a cost."""
    if text(value) not in ("duration", "effort"):
        raise ValueError(str(unknown("cost", value, ["duration", "effort"])))
    return value


def flag(value: Any) -> bool:
    """Read true or false."""
    if not isinstance(value, bool):
        raise TypeError(f"expected true or false, got {short(value)}")
    return value


def text(value: Any) -> str:
    """Read a text."""
    if not isinstance(value, str):
        raise TypeError(f"expected a name, got {short(value)}")
    return value


def names(value: Any) -> tuple[str, ...]:
    """Read a list of names."""
    if not isinstance(value, list) or not value:
        raise TypeError(f"expected a list of names, got {short(value)}")
    return tuple(text(name) for name in value)


def held(value: Any) -> Hold:
    """Read joints that are held: `all`, a list of names, or a mapping of names to positions."""
    if value == "all":
        return "all"
    if isinstance(value, dict):
        return {text(key): numbers(at if isinstance(at, list) else [at]) for key, at in value.items()}
    if isinstance(value, list):
        return names(value)
    raise TypeError(f"expected all, a list of joints, or joints with their positions, got {short(value)}")


def numbers(value: Any) -> tuple[float, ...]:
    """Read a list of finite numbers."""
    if not isinstance(value, list):
        raise TypeError(f"expected a list of numbers, got {short(value)}")
    return tuple(_number(v) for v in value)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"expected finite numbers, got {short(value)}")
    return float(value)


def positive(value: Any) -> float:
    """Read a positive number."""
    if not _number(value) > 0:
        raise ValueError(f"must be positive, got {short(value)}")
    return float(value)


def weights(value: Any) -> tuple[float, ...]:
    """Read numbers that are not negative."""
    if any(number < 0 for number in numbers(value)):
        raise ValueError(f"weights must not be negative, got {short(value)}")
    return numbers(value)


def speeds(value: Any) -> tuple[float, ...]:
    """Read one positive number or several."""
    read = numbers(value if isinstance(value, list) else [value])
    if any(speed <= 0 for speed in read):
        raise ValueError(f"speeds must be positive, got {short(value)}")
    return read
