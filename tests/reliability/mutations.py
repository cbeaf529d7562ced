"""Changes of files: hypothesis strategies of functions from a file's bytes to other bytes."""

import io
import json
import re
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from planspace.storage.arrays import read_arrays, write_arrays
from planspace.storage.json_files import json_hash

Change = Callable[[bytes], bytes]
Edit = tuple[float, float, bytes]
"""Start and stop of a section, as fractions of the file's length, and what replaces it."""

TOKENS = [b"", b"0", b"-1", b"1e999", b"1e308", b"-1e308", b"1e-320", b"9" * 30, b"9" * 5000, b"nan", b".inf"]
TOKENS += [b"0x9", b"null", b"true", *(bytes([c]) for c in b"[]{},:\"'\n\r\t\0"), b"[]", b"{}", b"*a", b"&a "]
TOKENS += [b"<<", b"!!int", b"!!map", b"1:1", b"2020-01-01", b"#", b"---\n", b"| ", b"? ", b"\xff", b"../x"]
TOKENS += [
    b"/",
    b"<",
    b"/>",
    b"&lt;",
    "é".encode(),
    b"\x1b[2J",
    b"ball",
    b"free",
    b"mesh",
    b"include",
    b"xyz",
]
NUMBERS = [0, -1, 1, 2, 3, 100, 2**31, 2**63, -(2**63), 10**30, 0.5, -0.0, 1e-320, 1e100, 1e308, -1e308]
NUMBERS += [float("nan"), float("inf"), -float("inf")]
TEXTS = ["", "a", "x", "../x", "/etc/passwd", "a\0b", "a\nb", "\ud800", "é", "1", "none", "embedding-1"]
VALUES = st.recursive(
    st.none() | st.booleans() | st.sampled_from(NUMBERS) | st.sampled_from(TEXTS),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(TEXTS), inner, max_size=2),
    max_leaves=4,
)
FRACTIONS = st.floats(0, 1, exclude_max=True)
REMOVED = "removed"


@st.composite
def edits(draw: st.DrawFn) -> list[Edit]:
    """One to three edits."""
    fractions = st.floats(0, 1)
    return [
        (*sorted((draw(fractions), draw(fractions))), draw(st.binary(max_size=40)))
        for _ in range(draw(st.integers(1, 3)))
    ]


def edit(edits: list[Edit], data: bytes) -> bytes:
    for start, stop, replacement in edits:
        data = data[: int(start * len(data))] + replacement + data[int(stop * len(data)) :]
    return data


def replace_tokens(tokens: list[tuple[float, bytes]], data: bytes) -> bytes:
    """Replace words and symbols of a text; each place is a fraction of their number."""
    for place, token in tokens:
        found = [match.span() for match in re.finditer(rb"[\w.+-]+|\S", data)]
        start, stop = found[int(place * len(found))] if found else (0, 0)
        data = data[:start] + token + data[stop:]
    return data


def replace_values(changes: list[tuple[list[float], Any]], data: bytes, *, sealed: bool) -> bytes:
    """Replace or remove values inside a JSON file, and recompute its checksum, as an attacker can."""
    content = json.loads(data)
    content.pop("checksum", None)
    for (*path, last), value in changes:
        inner = content
        for place in path:
            key = nth_key(inner, place)
            if not isinstance(inner[key], dict | list) or not inner[key]:
                break
            inner = inner[key]
        if not inner:
            continue
        key = nth_key(inner, last)
        if value == REMOVED:
            del inner[key]
        else:
            inner[key] = value
    seal = {"checksum": json_hash(content)} if sealed else {}
    return (json.dumps({**content, **seal}) + "\n").encode()


def nth_key(inner: Any, place: float) -> Any:
    """The key of a mapping or list at a place that is a fraction of its length."""
    keys = sorted(inner) if isinstance(inner, dict) else range(len(inner))
    return keys[int(place * len(keys))]


def change_arrays(
    arrays: dict[str, np.ndarray], changes: list[tuple[float, float, Any]]
) -> dict[str, np.ndarray]:
    """Change values, types and shapes of arrays, or remove them."""
    arrays = {name: array.copy() for name, array in arrays.items()}
    for which, where, change in changes:
        name = nth_key(arrays, which)
        array = arrays[name]
        if change == REMOVED and len(arrays) > 1:
            del arrays[name]
        elif isinstance(change, str) and change != REMOVED:
            with np.errstate(all="ignore"):
                arrays[name] = array.astype(change)
        elif isinstance(change, tuple):
            arrays[name] = np.resize(array, change)
        elif isinstance(change, float) and array.size:
            with np.errstate(all="ignore"):
                array.flat[int(where * array.size)] = np.float64(change).astype(array.dtype)
    return arrays


def change_npz(changes: list[tuple[float, float, Any]], data: bytes) -> bytes:
    with np.load(io.BytesIO(data)) as archive:
        arrays = change_arrays(dict(archive), changes)
    np.savez_compressed(file := io.BytesIO(), **arrays)
    return file.getvalue()


def change_safetensors(changes: list[tuple[float, float, Any]], data: bytes) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "f"
        file.write_bytes(data)
        size = int.from_bytes(data[:8], "little")
        metadata = json.loads(json.loads(data[8 : 8 + size])["__metadata__"]["planspace"])["about"]
        write_arrays(file, change_arrays(read_arrays(file), changes), metadata=metadata)
        return file.read_bytes()


_TOKEN_CHANGES = st.lists(st.tuples(FRACTIONS, st.sampled_from(TOKENS)), min_size=1, max_size=3)
_VALUE_CHANGES = st.lists(
    st.tuples(st.lists(FRACTIONS, min_size=1, max_size=5), VALUES | st.just(REMOVED)), min_size=1, max_size=3
)
_ARRAY_CHANGES = st.lists(
    st.tuples(
        FRACTIONS,
        FRACTIONS,
        st.sampled_from([REMOVED, "float16", "float32", "float64", "int8", "int64", "uint64", "bool"])
        | st.sampled_from([(), (0,), (1,), (3,), (0, 2), (2, 0), (3, 2), (5, 1), (2, 2, 2)])
        | st.sampled_from([float(x) for x in NUMBERS if abs(x) < 2**62 or not isinstance(x, int)]),
    ),
    min_size=1,
    max_size=3,
)
BYTES = st.builds(partial, st.just(edit), edits())
TEXT = BYTES | st.builds(partial, st.just(replace_tokens), _TOKEN_CHANGES)
PLAIN_JSON = TEXT | st.builds(partial, st.just(partial(replace_values, sealed=False)), _VALUE_CHANGES)
SEALED_JSON = st.builds(partial, st.just(partial(replace_values, sealed=True)), _VALUE_CHANGES)
NPZ = BYTES | st.builds(partial, st.just(change_npz), _ARRAY_CHANGES)
SAFETENSORS = st.builds(partial, st.just(change_safetensors), _ARRAY_CHANGES)
