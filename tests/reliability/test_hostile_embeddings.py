"""Hostile embeddings are rejected, and nothing else happens."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.embed.saved_embedding import load_embedding
from planspace.storage.arrays import read_arrays, write_arrays

from .audit import Change, assert_rejected, reseal


def raw_safetensors(header: bytes | dict[str, Any], data: bytes) -> bytes:
    head = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(head)) + head + data


def tensor(start: int, end: int, shape: list[int], dtype: str = "F64") -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "data_offsets": [start, end]}


DEEP = b'{"a":' * 100_000
SAFETENSORS = {
    "overlap": raw_safetensors({"a": tensor(0, 16, [2]), "b": tensor(8, 24, [2])}, bytes(24)),
    "gap": raw_safetensors({"a": tensor(0, 8, [1]), "b": tensor(16, 24, [1])}, bytes(24)),
    "longer than the file": raw_safetensors({"a": tensor(0, 8, [1 << 40])}, bytes(8)),
    "shape overflows": raw_safetensors({"a": tensor(0, 8, [1 << 62, 1 << 62])}, bytes(8)),
    "negative offsets": raw_safetensors({"a": tensor(-8, 8, [2])}, bytes(8)),
    "enormous header": struct.pack("<Q", 1 << 62) + b"{}",
    "pickle for a header": raw_safetensors(b"\x80\x04\x95pickle", b""),
    "unknown type": raw_safetensors({"a": tensor(0, 8, [1], "OBJECT")}, bytes(8)),
    "nested too deep": raw_safetensors(DEEP, b""),
    "empty": raw_safetensors({}, b""),
}


@pytest.mark.parametrize("trick", SAFETENSORS)
def test_malformed_safetensors_are_rejected(trick: str, saved_embedding: Path) -> None:
    (saved_embedding / "embedding.safetensors").write_bytes(SAFETENSORS[trick])
    message = r"embedding.embedding\.%s was altered"
    assert_rejected(saved_embedding, lambda: load_embedding(saved_embedding), message % "safetensors")
    reseal(saved_embedding / "embedding.json", lambda content: None)
    assert_rejected(saved_embedding, lambda: load_embedding(saved_embedding), message % r"\w+")


def set_nan(arrays: dict[str, Any]) -> None:
    arrays["encoder.0.weight"][0, 0] = np.nan


def set_infinite(arrays: dict[str, Any]) -> None:
    arrays["decoder.0.bias"][0] = -np.inf


WEIGHTS: dict[str, tuple[Change, str]] = {
    "NaN": (set_nan, "encoder.0.weight contains a number that is not finite"),
    "infinite": (set_infinite, "decoder.0.bias contains a number that is not finite"),
    "missing": (lambda a: a.pop("encoder.1.weight"), "is invalid"),
    "no networks": (lambda a: [a.pop(k) for k in list(a) if "coder" in k], "are incomplete"),
    "too large a layer": (lambda a: a.update({"encoder.0.weight": np.ones((900, 7))}), "is invalid"),
    "zero standard deviation": (lambda a: a.update(deviation=0 * a["deviation"]), "are incomplete"),
    "wrong type": (lambda a: a.update(mean=a["mean"].astype(bool)), "is invalid|are incomplete"),
    "too large to encode with": (lambda a: a["encoder.0.weight"].fill(1e38), "numbers that are not finite"),
    "too large to decode with": (lambda a: a["decoder.0.weight"].fill(1e38), "numbers that are not finite"),
}


@pytest.mark.parametrize("trick", WEIGHTS)
def test_invalid_weights_are_rejected(trick: str, saved_embedding: Path) -> None:
    change, message = WEIGHTS[trick]
    weights = saved_embedding / "embedding.safetensors"
    arrays = {name: array.copy() for name, array in read_arrays(weights).items()}
    change(arrays)
    write_arrays(weights, arrays)
    reseal(saved_embedding / "embedding.json", lambda content: None)
    assert_rejected(saved_embedding, lambda: load_embedding(saved_embedding), message)


DESCRIPTIONS: dict[str, tuple[Change, str]] = {
    "code as architecture": (lambda d: d.update(architecture="os:system"), "names the architecture"),
    "a newer schema": (lambda d: d.update(schema=10**6), "written by a newer planspace"),
    "no schema": (lambda d: d.pop("schema"), "has no schema number"),
    "another kind": (lambda d: d.update(kind="demos"), "is of kind 'demos'"),
    "unknown observation type": (lambda d: d["inputs"].update(form="pickle"), "is invalid"),
    "numbers as names": (lambda d: d["inputs"].update(names=[1, 2, 3, 4]), "is invalid"),
    "angle in a column that does not exist": (
        lambda d: d["inputs"].update(circular_columns=[-9]),
        "not a column",
    ),
    "no inputs": (lambda d: d.pop("inputs"), "is invalid"),
    "another size": (lambda d: d.update(z_dim=10**9), "the sizes of its networks do not match"),
    "another seed": (lambda d: d["about"].update(seed=99), "its selected seed is not one of the trained"),
}


@pytest.mark.parametrize("trick", DESCRIPTIONS)
def test_false_descriptions_are_rejected(trick: str, saved_embedding: Path) -> None:
    change, message = DESCRIPTIONS[trick]
    reseal(saved_embedding / "embedding.json", change)
    assert_rejected(saved_embedding, lambda: load_embedding(saved_embedding), message)
