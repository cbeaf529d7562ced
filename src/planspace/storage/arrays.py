"""Named arrays in safetensors files, with a checksum of their own content."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from planspace.errors import PlanspaceError
from planspace.storage.checks import (
    MAX_BYTES,
    check_file,
    damage_error,
    explain_memory_error,
    explain_read,
)
from planspace.storage.files import read_bytes, write_bytes
from planspace.storage.json_files import CHECKSUM_KEY

Arrays = dict[str, np.ndarray]

INNER = "planspace"
"""Key of a safetensors file's header that holds our metadata and checksum."""


def write_arrays(path: Path, arrays: Arrays, *, metadata: Mapping[str, Any] | None = None) -> str:
    """Write named arrays as one safetensors file that holds a checksum of its own content.

    Args:
        path: the file.
        arrays: the arrays by name.
        metadata: plain data to keep in the same file, so that both change in one step.

    Returns:
        SHA-256 of the file.
    """
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    inner = _inner_text(contiguous, json.loads(json.dumps(metadata)))
    data = safetensors.numpy.save(contiguous, metadata={INNER: inner})
    write_bytes(path, data)
    return hashlib.sha256(data).hexdigest()


def read_arrays(path: Path, *, sha256: str | None = None) -> Arrays:
    """Read the arrays of a safetensors file.

    Args:
        path: the file.
        sha256: expected hash of the file. None relies on the checksum in the file, which detects damage but
            not deliberate changes.

    Raises:
        PlanspaceError: the file is missing or damaged, has another hash, or `check_file` rejects it.
    """
    with explain_memory_error(path):
        return _read_arrays(path, sha256)[0]


def read_array(path: Path, name: str) -> np.ndarray:
    """Read one array of a safetensors file without verifying the file again.

    Raises:
        PlanspaceError: the file is missing or unreadable, or has no such array.
    """
    check_file(path, most=MAX_BYTES)
    try:
        with explain_read(path), safetensors.safe_open(path, framework="numpy") as file:
            return file.get_tensor(name)
    except safetensors.SafetensorError as error:
        raise damage_error(path, f"it is not a readable safetensors file ({error})") from error


def read_arrays_and_metadata(path: Path) -> tuple[Arrays, dict[str, Any]]:
    """Read the arrays of a safetensors file and the metadata that `write_arrays` stored with them.

    Raises:
        PlanspaceError: the file is missing or damaged, or holds no metadata.
    """
    with explain_memory_error(path):
        arrays, metadata = _read_arrays(path, None)
    if not isinstance(metadata, dict):
        raise PlanspaceError(f"{path} holds arrays but not the expected metadata.")
    return arrays, metadata


def _read_arrays(path: Path, sha256: str | None) -> tuple[Arrays, Any]:
    data = read_bytes(path)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
        raise damage_error(path, "its SHA-256 is not the one recorded for it")
    try:
        arrays = safetensors.numpy.load(data)
        size = int.from_bytes(data[:8], "little")
        header = json.loads(data[8 : 8 + size]).get("__metadata__", {})
        if not header and sha256 is not None:  # written by another program; the caller knows its hash
            return arrays, None
        metadata = json.loads(header[INNER])["about"]
        is_whole = header[INNER] == _inner_text(arrays, metadata)
    except (safetensors.SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise damage_error(path, f"it is not a readable safetensors file ({error})") from error
    if not is_whole:
        raise damage_error(path, "it does not match its own checksum")
    return arrays, metadata


def _inner_text(arrays: Arrays, metadata: Any) -> str:
    return json.dumps({"about": metadata, CHECKSUM_KEY: arrays_hash(arrays, metadata)}, sort_keys=True)


def arrays_hash(arrays: Arrays, metadata: Any = None) -> str:
    """SHA-256 of named arrays, with their types and shapes, and of plain data."""
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
