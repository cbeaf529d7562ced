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
from planspace.storage.checks import MAX_BYTES, check_file, damage_error, explain_memory_error, explain_read
from planspace.storage.files import read_bytes, write_bytes
from planspace.storage.json_files import CHECKSUM_KEY

Arrays = dict[str, np.ndarray]
INNER = "planspace"
"""Where a safetensors file keeps what is said about its arrays."""


def write_arrays(path: Path, arrays: Arrays, *, metadata: Mapping[str, Any] | None = None) -> str:
    """Writes named arrays as one safetensors file, which holds a checksum of its own content.

    Args:
        path: the file.
        arrays: the arrays by name.
        metadata: plain data to keep in the same file, so that both change in one step.

    Returns:
        The SHA-256 of the file.
    """
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    inner = _inner_text(contiguous, json.loads(json.dumps(metadata)))
    data = safetensors.numpy.save(contiguous, metadata={INNER: inner})
    write_bytes(path, data)
    return hashlib.sha256(data).hexdigest()


def read_arrays(path: Path, *, sha256: str | None = None) -> Arrays:
    """Reads the arrays of a safetensors file.

    Args:
        path: the file.
        sha256: what its hash must be; None trusts the checksum in the file, which finds damage alone.

    Raises:
        PlanspaceError: missing, damaged, its hash is another, or one that `check_file` refuses.
    """
    with explain_memory_error(path):
        return _read_arrays(path, sha256)[0]


def read_array(path: Path, name: str) -> np.ndarray:
    """Reads one array of a safetensors file that has been verified before, and no more of it.

    Raises:
        PlanspaceError: the file is missing or unreadable, or has no such array.
    """
    check_file(path, most=MAX_BYTES)
    try:
        with explain_read(path), safetensors.safe_open(path, framework="numpy") as file:
            return file.get_tensor(name)
    except safetensors.SafetensorError as error:
        raise damage_error(path, f"no readable safetensors file ({error})") from error


def read_arrays_and_metadata(path: Path) -> tuple[Arrays, dict[str, Any]]:
    """Reads the arrays of a safetensors file, and the plain data that `write_arrays` kept with them.

    Raises:
        PlanspaceError: missing, damaged, or written without it.
    """
    with explain_memory_error(path):
        arrays, about = _read_arrays(path, None)
    if not isinstance(about, dict):
        raise PlanspaceError(f"{path} does not hold the description expected in it.")
    return arrays, about


def _read_arrays(path: Path, sha256: str | None) -> tuple[Arrays, Any]:
    data = read_bytes(path)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
        raise damage_error(path, "its SHA-256 is not the one recorded for it")
    try:
        arrays = safetensors.numpy.load(data)
        size = int.from_bytes(data[:8], "little")
        metadata = json.loads(data[8 : 8 + size]).get("__metadata__", {})
        if not metadata and sha256 is not None:  # of somebody else, who vouches for it
            return arrays, None
        about = json.loads(metadata[INNER])["about"]
        is_whole = metadata[INNER] == _inner_text(arrays, about)
    except (safetensors.SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise damage_error(path, f"no readable safetensors file ({error})") from error
    if not is_whole:
        raise damage_error(path, "it does not match its own checksum")
    return arrays, about


def _inner_text(arrays: Arrays, about: Any) -> str:
    return json.dumps({"about": about, CHECKSUM_KEY: _arrays_hash(arrays, about)}, sort_keys=True)


def _arrays_hash(arrays: Arrays, about: Any) -> str:
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
