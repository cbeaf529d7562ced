"""Saved settings: reading those of earlier versions, and listing what differs."""

import copy
import re
from collections.abc import Iterator, Mapping
from typing import Any


def update_settings(
    saved: Mapping[str, Any], *, renamed: Mapping[str, str], added: Mapping[str, Any]
) -> dict[str, Any]:
    """Convert settings that an earlier version saved to today's names.

    Args:
        saved: plain data, as read from `config.json`; it is not modified.
        renamed: old name to new name. A name is a path through nested mappings, separated by dots, for
            example `{"fit.near": "fit.objective.short_fraction"}`.
        added: settings that the earlier version did not have, with the value that reproduces what it did.

    Returns:
        The settings under today's names. Names that are not in the tables stay.
    """
    settings = copy.deepcopy(dict(saved))
    for old, new in renamed.items():
        *path, last = old.split(".")
        inner = _inner(settings, path)
        if inner is not None and last in inner:
            _set(settings, new, inner.pop(last))
    for name, value in added.items():
        *path, last = name.split(".")
        inner = _inner(settings, path)
        if inner is None or last not in inner:
            _set(settings, name, value)
    return settings


def list_differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """List each value that differs between two trees of plain data, as "NAME was OLD, now NEW".

    Of a hash it only says that its content has changed.
    """
    for key in sorted(old.keys() | new.keys()):
        before, now = old.get(key), new.get(key)
        if isinstance(before, dict) and isinstance(now, dict):
            yield from list_differences(before, now, f"{prefix}{key}.")
        elif _is_hash(before) and _is_hash(now) and before != now:
            yield f"{prefix}{key} has changed"
        elif before != now:
            was, is_now = (repr(tree[key]) if key in tree else "not set" for tree in (old, new))
            yield f"{prefix}{key} was {was}, now {is_now}"


def _is_hash(value: Any) -> bool:
    return isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None


def _inner(settings: dict[str, Any], path: list[str]) -> dict[str, Any] | None:
    """The mapping at a path, or None."""
    for key in path:
        value = settings.get(key)
        if not isinstance(value, dict):
            return None
        settings = value
    return settings


def _set(settings: dict[str, Any], name: str, value: Any) -> None:
    *path, last = name.split(".")
    for key in path:
        if not isinstance(settings.get(key), dict):
            settings[key] = {}
        settings = settings[key]
    settings[last] = value
