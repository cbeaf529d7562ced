"""Hostile datasets and imports are rejected, and nothing else happens."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.describe import validate
from planspace.demos.folder import DemoFolder
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError
from planspace.storage.arrays import read_arrays, write_arrays
from planspace.storage.files import file_hash

from .audit import Change, assert_rejected, reseal
from .saved_files import GOLDEN
from .test_hostile_embeddings import DEEP


def first_shard(text: dict[str, Any]) -> dict[str, Any]:
    return text["shards"][0]


def set_diverged(states: np.ndarray) -> np.ndarray:
    states[3, 1] = np.inf
    return states


MANIFESTS: dict[str, Change] = {
    "shard outside": lambda d: first_shard(d).update(file="../../secret.safetensors"),
    "absolute path of a shard": lambda d: first_shard(d).update(file="/etc/passwd"),
    "URL of a shard": lambda d: first_shard(d).update(file="file:///etc/passwd"),
    "too many episodes": lambda d: first_shard(d).update(episodes=10**15),
    "text as a size": lambda d: first_shard(d).update(states="many"),
    "no list of shards": lambda d: d.pop("shards"),
    "null as a shard": lambda d: d.update(shards=[None]),
    "numbers as names": lambda d: d["info"].update(names=[1, 2, 3, 4]),
    "wrong number of names": lambda d: d["info"].update(names=["a"], units=["m"], circular_columns=[]),
    "angle in a column that does not exist": lambda d: d["info"].update(circular_columns=[99]),
    "no info": lambda d: d.pop("info"),
    "repeated shard": lambda d: d["shards"].append(first_shard(d)),
    "mapping as shards": lambda d: d.update(shards={}),
    "negative index": lambda d: d.update(next_index=-1),
    "text as names": lambda d: d["info"].update(names="abcd"),
    "negative number of controls": lambda d: d["info"].update(num_controls=-1),
    "incomplete quaternion": lambda d: d["info"].update(quaternion_columns=[2]),
    "text as a flag": lambda d: d["info"].update(kinematic="no"),
}


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    demos = load_demos(GOLDEN / "demos")
    folder = DemoFolder(tmp_path / "d", demos.info, {"seed": 0})
    folder.append([demos.episode(i) for i in range(3)], next_index=3)
    return tmp_path / "d"


@pytest.mark.parametrize("trick", MANIFESTS)
def test_false_manifests_are_rejected(trick: str, dataset: Path, tmp_path: Path) -> None:
    reseal(dataset / "manifest.json", MANIFESTS[trick])
    assert_rejected(dataset, lambda: load_demos(dataset), "is invalid")


SHARDS: dict[str, Change] = {
    "diverged": lambda a: set_diverged(a["states"]),
    "decreasing offsets": lambda a: a.update(offsets=a["offsets"][::-1].copy()),
    "no controls": lambda a: a.pop("controls"),
    "wrong type": lambda a: a.update(times=a["times"].astype(np.uint8)),
}


@pytest.mark.parametrize("trick", SHARDS)
def test_invalid_shards_are_rejected(trick: str, dataset: Path, tmp_path: Path) -> None:
    file = dataset / "shard-00000.safetensors"
    arrays = {name: array.copy() for name, array in read_arrays(file).items()}
    SHARDS[trick](arrays)
    write_arrays(file, arrays)
    reseal(dataset / "manifest.json", lambda content: first_shard(content).update(sha256=file_hash(file)))
    assert_rejected(dataset, lambda: load_demos(dataset), r"shard-00000.safetensors .*is invalid")


@pytest.mark.parametrize(
    "text",
    [b"[" * 200_000, DEEP, b'{"schema": ' + b"9" * 50_000 + b"}\n", b"\xff\xfe{}", b"[]\n", b"", b"NaN\n"],
    ids=["nested list", "nested object", "many digits", "not text", "list", "empty", "NaN"],
)
def test_malformed_json_is_rejected(text: bytes, dataset: Path, tmp_path: Path) -> None:
    (dataset / "manifest.json").write_bytes(text)
    assert_rejected(dataset, lambda: load_demos(dataset), "manifest.json was altered or damaged")


def test_pickled_objects_in_an_archive_are_rejected(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "triggered",))

    given, objects = tmp_path / "given", np.array([Bomb()], dtype=object)
    given.mkdir()
    np.savez(given / "bomb.npz", states=objects, controls=objects, offsets=objects)

    def read() -> None:
        import_demos([str(given / "bomb.npz")], given / "out", None, ImportOptions())

    assert_rejected(given, read, r"bomb\.npz")
    assert not (tmp_path / "triggered").exists() and not (given / "out" / "manifest.json").exists()


LONG_CELLS = {"text": "x" * 4000, "list": [0] * 4000, "object": {"x" * 4000: [[0]] * 4000}}


@pytest.mark.parametrize("cell", LONG_CELLS.values(), ids=LONG_CELLS)
def test_a_long_cell_is_quoted_shortened(cell: Any, tmp_path: Path) -> None:
    (tmp_path / "plan_0.json").write_text(json.dumps({"state_dims": ["x"], "path": [[0], [cell]]}))
    with pytest.raises(PlanspaceError, match="row 1 of path contains .*not a finite number") as caught:
        import_demos([str(tmp_path / "plan_0.json")], tmp_path / "out", None, ImportOptions())
    assert len(str(caught.value)) < 300 + len(str(tmp_path))


@pytest.mark.parametrize(
    "inside", ['<include file="/etc/passwd"/>', '<asset><mesh file="/etc/m.stl"/></asset>']
)
def test_a_model_in_a_dataset_that_refers_to_files_is_rejected(
    inside: str, dataset: Path, tmp_path: Path
) -> None:
    model = f"<mujoco>{inside}</mujoco>"
    reseal(dataset / "manifest.json", lambda content: content["info"].update(mjcf=model))
    assert_rejected(dataset, lambda: validate(dataset, replay_controls=True), "refers to '/etc/")
