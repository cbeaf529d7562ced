"""`--config FILE`: settings from a YAML file, or from the config.json of an earlier run.

A file changes the defaults that tyro starts from, so that `--help` shows its values, and options on the
command line still win. The options that decide which settings exist, such as `--preset`, are read first.
"""

import contextlib
import re
import types
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from tyro.conf import arg

from planspace.errors import UsageError, quoted, unknown
from planspace.seams import is_object_path, load_object
from planspace.storage.json_files import read_json
from planspace.tasks.strict_yaml import read_yaml

Config = TypeVar("Config")

ConfigFile = Annotated[
    Path | None,
    arg(
        name="config",
        metavar="FILE",
        help="Settings from a YAML file, or from the config.json or manifest.json of an earlier run. Options "
        "on the command line win.",
        help_behavior_hint="(default: none)",
    ),
]
"""The option `--config`."""


def given_option(arguments: Sequence[str], name: str) -> str | None:
    """The last value that a command line gives to an option, or None.

    Args:
        arguments: the command line after its verb.
        name: for example `--preset`; `--preset X` and `--preset=X` are understood.
    """
    found = None
    for position, argument in enumerate(arguments):
        option, equals, value = argument.partition("=")
        if option.replace("_", "-") == name:
            found = value if equals else next(iter(arguments[position + 1 : position + 2]), None)
    return found


def given_config(arguments: Sequence[str]) -> tuple[str, dict[str, Any]]:
    """The file that a command line gives to `--config`, and its settings; both are empty without one."""
    path = given_option(arguments, "--config") or ""
    return path, read_config(path) if path else {}


def given_name(arguments: Sequence[str], file: Mapping[str, Any], option: str, where: str) -> str | None:
    """The name that an option has on the command line or, without it, in a file of settings; or None.

    Args:
        arguments: the command line after its verb.
        file: the content of the file.
        option: for example `preset`.
        where: the file, for messages.

    Raises:
        UsageError: the file has something else than a name there.
    """
    name = given_option(arguments, f"--{option}") or file.get(option)
    if not isinstance(name, str | None):
        raise UsageError(f"{where}: {option} must be a name, got {quoted(name)}.")
    return name


def group_in_file(file: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    """The group of settings under a key of a file; empty if the file does not have the key.

    Args:
        file: the content of the file.
        key: the key.
        where: the file, for messages.

    Raises:
        UsageError: the key does not hold a group of settings.
    """
    group = file.get(key, {})
    if not isinstance(group, Mapping):
        raise UsageError(f"{where}: {key} must be a group of settings, got {quoted(group)}.")
    return group


def check_least(verb: object, **least: int) -> None:
    """Check the smallest values of a verb's options.

    Args:
        verb: holds the values.
        least: smallest value by the name of the field.

    Raises:
        UsageError: a value is smaller.
    """
    for name, smallest in least.items():
        if (value := getattr(verb, name)) < smallest:
            raise UsageError(f"`--{name.replace('_', '-')}` must be at least {smallest}, got {value}.")


def load_or_name(given: str) -> Any:
    """The object that `module.py:NAME` names in the user's own code, or the name of a shipped one."""
    return load_object(given) if is_object_path(given) else given


def named_in_file(settings: Mapping[str, Any], seam: str, where: str) -> str | None:
    """The name of the shipped object that a file's settings belong to, or None.

    Args:
        settings: the content of the file.
        seam: the field that holds the object, such as `planner`.
        where: the file, for messages.

    Raises:
        UsageError: the object is a user's own, which only the command line may name, or has no valid name.
    """
    group = group_in_file(settings, seam, where)
    name = group.get("name")
    if not isinstance(name, str | None):
        raise UsageError(f"{where}: the name of the {seam} must be text, got {quoted(name)}.")
    if "source_sha256" in group or is_object_path(str(name)):
        raise UsageError(
            f"{where} was made with the {seam} {quoted(name)}, which is your own code: name it on the "
            "command line as module.py:NAME."
        )
    return name


def refuse_inputs(settings: Mapping[str, Any], where: str, **options: str) -> None:
    """Refuse folders in a file of settings. A run's own config.json names what it read by hashes.

    Args:
        settings: the content of the file.
        where: the file, for messages.
        options: for each key, the option that takes the folder.

    Raises:
        UsageError: a key holds something else than hashes.
    """
    for key, option in options.items():
        given = settings.get(key) or ()
        each = given if isinstance(given, Sequence) and not isinstance(given, str) else (given,)
        if any(not isinstance(one, str) or not re.fullmatch("[0-9a-f]{64}", one) for one in each):
            raise UsageError(f"{where}: `{key}` cannot be set in a file: use {option}.")


def whole_in_file(settings: Mapping[str, Any], name: str, where: str, least: int) -> int | None:
    """A whole number in a file of settings; None without it.

    Raises:
        UsageError: it is something else, or less than `least`.
    """
    if name not in settings:
        return None
    value = settings[name]
    if type(value) is not int or value < least:
        raise UsageError(f"{where}: {name} must be a whole number of at least {least}, got {quoted(value)}.")
    return value


def read_config(path: str | Path) -> dict[str, Any]:
    """Read a file of settings, JSON if its name ends in .json and YAML otherwise.

    Raises:
        PlanspaceError: the file cannot be read, or is not a mapping of names to values.
    """
    path = Path(path)
    return read_json(path) if path.suffix == ".json" else read_yaml(path)


def with_settings(
    config: Config, settings: Mapping[str, Any], where: str, *, ignored: Collection[str] = ()
) -> Config:
    """A copy of a nested config with the settings of a file.

    Args:
        config: the dataclass that the settings change.
        settings: field to value; nested for a field that is a dataclass itself. The key `name` of a seam
            object is checked against the object that `config` holds.
        where: the file, for messages.
        ignored: keys that a run's config.json records and that are not settings, such as versions.

    Raises:
        UsageError: a key is not a field, or a value is not of the field's type or range.
    """
    hints, known = get_type_hints(type(config)), {f.name: f for f in fields(config)}  # pyright: ignore
    changes: dict[str, Any] = {}
    other_names = _other_names(config)
    given_as: dict[str, str] = {}
    for given, value in settings.items():
        key = other_names.get(given, given)
        if key in given_as:
            raise UsageError(f"{where}: {given_as[key]} and {given} are the same setting: give one of them.")
        given_as[key] = given
        if key in ignored or (key in ("name", "source_sha256") and key not in known):
            continue
        if key not in known:
            raise UsageError(f"{where}: {unknown('setting', key, known)}")
        current = getattr(config, key)
        if is_dataclass(current) and not isinstance(current, type):
            changes[key] = with_settings(current, group_in_file(settings, key, where), where)
        else:
            changes[key] = _converted(value, hints[key], f"{where}: {key}")
    try:
        return replace(config, **changes)  # pyright: ignore[reportArgumentType]
    except (UsageError, ValueError) as error:
        raise UsageError(f"{where}: {error}") from error


def _other_names(config: Any) -> dict[str, str]:
    """The other names that options have on the command line, such as `seeds`, and their fields."""
    names = {}
    for name, hint in get_type_hints(type(config), include_extras=True).items():
        for option in getattr(hint, "__metadata__", ()):
            names |= {other.removeprefix("--"): name for other in getattr(option, "aliases", None) or ()}
    return names


def _converted(value: Any, hint: Any, where: str) -> Any:
    """A value of a file as its field's type, or an error."""
    origin, options = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in options:
            return None
        return _converted_to_one_of(value, [o for o in options if o is not type(None)], where)
    if origin is Literal:
        if value not in options:
            raise UsageError(f"{where} must be one of {', '.join(map(repr, options))}, got {quoted(value)}.")
        return value
    if origin is tuple:
        return _converted_tuple(value, options, where)
    if hint is float and isinstance(value, int | str) and not isinstance(value, bool):
        with contextlib.suppress(ValueError):  # YAML reads 1e-5 as text
            return float(value)
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint in (bool, int, float, str) and type(value) is hint:
        return value
    raise UsageError(f"{where} must be of type {getattr(hint, '__name__', hint)}, got {quoted(value)}.")


def _converted_to_one_of(value: Any, hints: Sequence[Any], where: str) -> Any:
    for hint in hints[:-1]:
        try:
            return _converted(value, hint, where)
        except UsageError:
            continue
    return _converted(value, hints[-1], where)


def _converted_tuple(value: Any, options: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise UsageError(f"{where} must be a list, got {quoted(value)}.")
    hints = [options[0]] * len(value) if options[1:] == (...,) else list(options)
    if len(hints) != len(value):
        raise UsageError(f"{where} must be a list of {len(hints)} values, got {len(value)}.")
    return tuple(_converted(v, h, f"{where}[{i}]") for i, (v, h) in enumerate(zip(value, hints, strict=True)))
