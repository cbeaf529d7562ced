"""JSON files, with or without a checksum of their own content."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planspace.errors import PlanspaceError
from planspace.storage.checks import MAX_JSON_BYTES, damage_error, explain_memory_error
from planspace.storage.files import read_bytes, write_bytes

CHECKSUM_KEY = "checksum"


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Writes a mapping as JSON, atomically."""
    write_bytes(path, _json_text(value))


def read_json(path: Path) -> dict[str, Any]:
    """Reads a JSON object.

    Raises:
        PlanspaceError: the file is missing, unreadable or no JSON object.
    """
    data = read_bytes(path, most=MAX_JSON_BYTES)
    try:
        with explain_memory_error(path):
            return _json_object(data)
    except (ValueError, RecursionError) as error:
        raise PlanspaceError(f"{path} is not valid JSON ({error}).") from error


def write_sealed(path: Path, value: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """Writes a JSON object with a checksum of its own content; without an indent on one line."""
    write_bytes(path, _sealed_text(json.loads(json.dumps(value)), indent))


def read_sealed(path: Path) -> dict[str, Any]:
    """Reads a JSON object written by `write_sealed` and verifies that no byte of it is another.

    Raises:
        PlanspaceError: missing, not JSON, or altered since it was written.
    """
    data = read_bytes(path, most=MAX_JSON_BYTES)
    try:
        with explain_memory_error(path):
            value = _json_object(data)
            value.pop(CHECKSUM_KEY, None)
            is_whole = data == _sealed_text(value, 2 if data.startswith(b"{\n") else None)
    except (ValueError, RecursionError) as error:  # numbers of too many digits, too
        raise damage_error(path, f"it is not valid JSON: {error}") from error
    if not is_whole:
        raise damage_error(path, "it does not match its own checksum")
    return value


def read_description(path: Path, *, kind: str, schema: int, name: str) -> dict[str, Any]:
    """Reads the sealed description of a folder of ours.

    Args:
        path: the file.
        kind: what the file must say that it describes.
        schema: the newest schema that is known.
        name: what it describes, for messages.

    Raises:
        PlanspaceError: altered, of another kind, or written by a newer planspace.
    """
    text = read_sealed(path)
    if text.get("kind") != kind:
        raise PlanspaceError(f"{path} describes no {name}.")
    if not isinstance(text.get("schema"), int):
        raise damage_error(path, "it names no schema")
    if text["schema"] > schema:
        raise PlanspaceError(
            f"{path.parent} was written by a newer planspace (schema {text['schema']}, this one reads up to "
            f"{schema}); upgrade planspace."
        )
    return text


def json_hash(value: Mapping[str, Any]) -> str:
    """SHA-256 of plain data, whatever the order of its keys."""
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
