"""What a function does, as plain data for a content hash.

A function is described by its source, by the plain numbers and texts that it reads from its module or its
closure, and by the functions of its module that it calls. Code that it imports is not described.
"""

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import numpy as np

from planspace.storage.files import file_hash

NESTING = 20
"""Values nested more deeply than this are described by their type."""


def function_settings(value: Any, depth: int = 0, *, describe_path: Callable[[Path], Any] = str) -> Any:
    """Describe a value, or a function by what it does, as plain data for JSON.

    Args:
        value: plain data, arrays, dataclasses of them, or functions.
        depth: how deeply it is nested.
        describe_path: describes paths, by default by their names; see `file_settings`.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Path):
        return describe_path(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if depth > NESTING:
        return type(value).__qualname__
    down = functools.partial(function_settings, depth=depth + 1, describe_path=describe_path)
    if isinstance(value, Mapping):
        return {str(key): down(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [down(item) for item in value]
    return _callable_settings(value, down)


def file_settings(path: Path) -> Any:
    """Describe a file by its name and content, so that it may move, and any other path by its text."""
    if not path.is_file():
        return str(path)
    return {"file": path.name, "sha256": file_hash(path)}


def _callable_settings(value: Any, down: Callable[[Any], Any]) -> Any:
    """Describe a function, a method with its object, or an object of a class.

    Args:
        value: what is described.
        down: describes the values that it holds.
    """
    if isinstance(value, MethodType) and hasattr(value.__self__, "hash_content"):  # it has its own version
        return {"method": value.__name__, "of": value.__self__.hash_content()}
    value = (
        inspect.unwrap(value) if isinstance(value, FunctionType) else value
    )  # its source has the decorators
    if isinstance(value, FunctionType):
        return _code(value, down)
    if isinstance(value, MethodType):
        return {"method": down(value.__func__), "of": down(value.__self__)}
    if isinstance(value, functools.partial):
        return {"partial": down(value.func), "arguments": [down(value.args), down(value.keywords)]}
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: down(getattr(value, f.name)) for f in fields(value)} | {"class": _source(type(value))}
    return _source(value if isinstance(value, type) else type(value))


def _code(function: FunctionType, down: Callable[[Any], Any]) -> dict[str, Any]:
    """The source of a function with the values and functions of its own module that it reads."""
    read: dict[str, Any] = {}
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        own = isinstance(value, FunctionType) and value.__module__ == function.__module__
        if own or isinstance(value, bool | int | float | str | list | tuple | dict | np.ndarray):
            read[name] = value
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        read[name] = cell.cell_contents
    if read.get(function.__name__) is function:  # it calls itself
        del read[function.__name__]
    described = {name: down(value) for name, value in sorted(read.items())}
    return {"source": _source(function), "reads": described}


def _source(defined: Any) -> str:
    try:
        return inspect.getsource(defined)
    except (OSError, TypeError):  # typed at a prompt, or written in C
        code = getattr(defined, "__code__", None)
        return defined.__qualname__ if code is None else f"{code.co_code.hex()} {code.co_consts!r}"
