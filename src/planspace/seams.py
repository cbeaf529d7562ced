"""The open seams: tasks, planners, objectives and algorithms that users write themselves.

A seam is a protocol of methods. Whatever has these methods fits, shipped or not; nothing asks for a class or
a name. By convention an implementation is a frozen dataclass whose fields are its settings, because then the
command line offers each field as an option, and the files of a run record it.
"""

import hashlib
import importlib
import inspect
import math
import sys
from collections.abc import Mapping
from dataclasses import Field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from planspace.errors import UsageError, check_setting, did_you_mean, quoted, unknown

Seam = TypeVar("Seam")


def unset_if(default: Any) -> dict[str, Any]:
    """The metadata of a dataclass field that `plain_settings` leaves out at this value."""
    return {"unset": default}


UNSET_IF_NONE = unset_if(None)
"""The metadata of a dataclass field that `plain_settings` leaves out if it is None."""
UNSET_IF_ZERO = unset_if(0.0)
"""The metadata of a dataclass field that `plain_settings` leaves out if it is 0."""


def load_object(where: str) -> Any:
    """Import an object from the user's own code.

    Only the command line calls this, with what the user typed. No file that planspace reads names code.

    Args:
        where: `module.py:NAME`, a path relative to the working directory, or `package.module:NAME`.

    Raises:
        UsageError: the file or the name does not exist, or importing the module fails.
    """
    module_name, _, name = where.rpartition(":")
    if not module_name or not name:
        raise UsageError(f"expected module.py:NAME, got {quoted(where)}.")
    if module_name.endswith(".py"):
        file = Path(module_name)
        if not file.is_file():
            raise UsageError(f"{module_name} does not exist, so {name} cannot be imported from it.")
        folder, module_name = str(file.resolve().parent), file.stem
        if folder not in sys.path:
            sys.path.insert(0, folder)  # as `python module.py` does; worker processes inherit the path
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever the user's module raises
        raise UsageError(f"importing {module_name} failed: {type(error).__name__}: {error}") from error
    if not hasattr(module, name):
        names = sorted(n for n in vars(module) if not n.startswith("_"))
        raise UsageError(
            f"{module_name} has no {quoted(name)}.{did_you_mean(name, names)} It has: {', '.join(names)}."
        )
    return getattr(module, name)


def is_object_path(text: str) -> bool:
    """Whether a command-line value has the form `module.py:NAME`."""
    return ".py:" in text


def check_fits(given: Any, protocol: type[Seam], page: str) -> Seam:
    """Check that an object has every method of a protocol.

    Args:
        given: the object that was handed over.
        protocol: a runtime-checkable protocol, such as `Planner`.
        page: the how-to page that explains it, such as `docs/howto/own-planner.md`.

    Returns:
        The object.

    Raises:
        UsageError: a class was given instead of an object, or a method is missing.
    """
    wanted = [
        name for name in dir(protocol) if not name.startswith("_") and callable(getattr(protocol, name))
    ]
    what = protocol.__name__
    if isinstance(given, type):
        raise UsageError(
            f"expected {article(what)}, got the class {given.__name__}: pass an instance. See {page}."
        )
    missing = [name for name in wanted if not callable(getattr(given, name, None))]
    if missing:
        methods = f"the method{'s' if len(wanted) > 1 else ''} {', '.join(wanted)}"
        raise UsageError(
            f"{article(what, capital=True)} needs {methods}; {quoted(given)} has no {', '.join(missing)}. "
            f"See {page}."
        )
    return given


def check_field_types(given: Any) -> None:
    """Check a dataclass's fields that are annotated as a number, as true or false, or as one of some names.

    Raises:
        UsageError: a field holds something else.
    """
    kinds = {
        int: ((int, np.integer), "a whole number"),
        float: ((int, float, np.integer, np.floating), "a number"),
        bool: ((bool, np.bool_), "true or false"),
    }
    for name, hint in get_type_hints(type(given)).items():  # without `Annotated`
        value = getattr(given, name)
        if get_origin(hint) is Literal and value not in get_args(hint):
            raise unknown(name, value, get_args(hint))
        if hint in kinds:
            types, wanted = kinds[hint]
            is_bool = isinstance(value, bool | np.bool_)
            check_setting(name, value, isinstance(value, types) and is_bool == (hint is bool), wanted)


def check_kind(name: str, given: Any, kind: type, advice: str = "") -> None:
    """Check the type of an argument; None passes.

    Args:
        name: the argument.
        given: its value.
        kind: the class that it must have.
        advice: what to do, at the end of the message.

    Raises:
        UsageError: it has another type.
    """
    if given is not None and not isinstance(given, kind):
        raise UsageError(f"`{name}` must be {article(kind.__name__)}, got {quoted(given)}{advice}.")


def article(noun: str, *, capital: bool = False) -> str:
    """A noun with its indefinite article, for messages."""
    word = "an" if noun[0] in "AEIOU" else "a"
    return f"{word.capitalize() if capital else word} {noun}"


def name_of(given: Any) -> str:
    """The name of a seam object: its class attribute `name`, or where its class or function is defined."""
    if isinstance(name := getattr(given, "name", None), str):
        return name
    kind = given if inspect.isroutine(given) else type(given)
    return f"{kind.__module__}:{kind.__qualname__}"


def with_settings(given: Seam, /, **changes: Any) -> Seam:
    """Copy a dataclass with other settings, its own or those of the dataclasses in its fields.

    Args:
        given: a dataclass.
        changes: new values by field name, for example `gae_lambda=0.9`. Of two fields with the same name, the
            outer one is changed.

    Raises:
        UsageError: no field has this name, or a value is out of its range.
    """
    known = _setting_names(given)
    for name in changes:
        if name not in known:
            raise unknown("setting", name, known)
    own = {f.name: changes[f.name] for f in _fields(given) if f.name in changes}
    nested = {name: value for name, value in changes.items() if name not in own}
    for f in _fields(given):
        part = getattr(given, f.name)
        if f.name not in own and (inner := nested.keys() & _setting_names(part)):
            own[f.name] = with_settings(part, **{name: nested.pop(name) for name in inner})
    return replace(given, **own) if own else given  # pyright: ignore[reportArgumentType]


def _setting_names(given: Any) -> set[str]:
    """The names of all fields, through nested dataclasses."""
    return {name for f in _fields(given) for name in (f.name, *_setting_names(getattr(given, f.name)))}


def _fields(given: Any) -> tuple[Field[Any], ...]:
    return fields(given) if is_dataclass(given) else ()


def is_unset(f: Field[Any], owner: Any) -> bool:
    """Whether a field has the value at which it is left out; see `unset_if`."""
    return "unset" in f.metadata and getattr(owner, f.name) == f.metadata["unset"]


def plain_settings(value: Any) -> Any:
    """Turn nested settings into plain data for JSON and hashing.

    Dataclasses become mappings of their fields. A seam object also records its `name`, and one that is not
    shipped records the SHA-256 of its source, so that changed code is a changed setting. A field with
    the metadata `unset_if` is left out at that value, as in files of versions without the field.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if is_dataclass(value) and not isinstance(value, type):
        given = {f.name: getattr(value, f.name) for f in fields(value) if not is_unset(f, value)}
        own = {name: plain_settings(item) for name, item in given.items()}
        return _identity(value) | own
    if isinstance(value, Mapping):
        return {key: plain_settings(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_settings(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)  # JSON has no infinity
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return _identity(value, always=True)


def _identity(value: Any, *, always: bool = False) -> dict[str, Any]:
    """The name of a seam object, and of foreign code its hash; empty for a plain group of settings."""
    kind = value if inspect.isroutine(value) else type(value)
    shipped = kind.__module__.partition(".")[0] == "planspace"
    if shipped and not (always or isinstance(getattr(kind, "name", None), str)):
        return {}
    if shipped:
        return {"name": name_of(value)}
    try:
        source = inspect.getsource(kind)
    except (OSError, TypeError):  # defined at a prompt
        source = kind.__qualname__
    return {"name": name_of(value), "source_sha256": hashlib.sha256(source.encode()).hexdigest()}
