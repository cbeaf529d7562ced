"""JSON files, plain or sealed with a checksum of their own content."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planspace.errors import PlanspaceError, quoted
from planspace.storage.checks import MAX_JSON_BYTES, damage_error, explain_memory_error
from planspace.storage.files import read_bytes, write_bytes

CHECKSUM_KEY = "checksum"


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a mapping as JSON, atomically."""
    write_bytes(path, _json_text(value))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        PlanspaceError: the file is missing, unreadable or not a JSON object.
    """
    data = read_bytes(path, most=MAX_JSON_BYTES)
    try:
        with explain_memory_error(path):
            return _json_object(data)
    except (ValueError, RecursionError) as error:
        raise PlanspaceError(f"{path} is not valid JSON ({error}).") from error


def write_sealed(path: Path, value: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """Write a JSON object together with a checksum of its own content.

    Args:
        path: the file.
        value: plain data.
        indent: spaces per level; None writes a single line.
    """
    write_bytes(path, _sealed_text(json.loads(json.dumps(value)), indent))


def read_sealed(path: Path) -> dict[str, Any]:
    """Read a JSON object written by `write_sealed` and verify every byte of it.

    Raises:
        PlanspaceError: the file is missing, not JSON, or was altered since it was written.
    """
    data = read_bytes(path, most=MAX_JSON_BYTES)
    try:
        with explain_memory_error(path):
            value = _json_object(data)
            value.pop(CHECKSUM_KEY, None)
            is_whole = data == _sealed_text(value, 2 if data.startswith(b"{\n") else None)
    except (ValueError, RecursionError) as error:  # also numbers of too many digits
        raise damage_error(path, f"it is not valid JSON: {error}") from error
    if not is_whole:
        raise damage_error(path, "it does not match its own checksum")
    return value


def read_description(path: Path, *, kind: str, schema: int) -> dict[str, Any]:
    """Read the sealed JSON file that describes a folder of a certain kind.

    Args:
        path: the file.
        kind: value that its key `kind` must have, for example `"embedding"`.
        schema: newest schema that this version can read.

    Raises:
        PlanspaceError: the file was altered, is of another kind, or was written by a newer planspace.
    """
    content = read_sealed(path)
    if content.get("kind") != kind:
        raise PlanspaceError(f"{path} is of kind {quoted(content.get('kind'))}, expected {kind!r}.")
    if not isinstance(content.get("schema"), int):
        raise damage_error(path, "it has no schema number")
    if content["schema"] > schema:
        raise PlanspaceError(
            f"{path.parent} was written by a newer planspace (schema {content['schema']}; this one reads up "
            f"to {schema}); upgrade planspace."
        )
    return content


def json_hash(value: Mapping[str, Any]) -> str:
    """Compute the SHA-256 of plain data, independent of the order of keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _json_text(value: Mapping[str, Any], indent: int | None = 2) -> bytes:
    return (json.dumps(value, indent=indent, allow_nan=False) + "\n").encode()


def _json_object(data: bytes) -> dict[str, Any]:
    value = json.loads(data)
    if not isinstance(value, dict):
        raise ValueError(f"it should hold an object, got a {type(value).__name__}")
    return value


def _sealed_text(plain: dict[str, Any], indent: int | None) -> bytes:
    return _json_text({**plain, CHECKSUM_KEY: json_hash(plain)}, indent)
