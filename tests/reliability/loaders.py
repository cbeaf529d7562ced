"""Loaders: each makes a file, and knows how it is read and how it can be changed."""

import io
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import event
from hypothesis import strategies as st

from planspace.cli.repair import repair
from planspace.demos.convert import import_demos
from planspace.demos.formats.minari import write_minari
from planspace.demos.formats.robomimic_export import write_robomimic
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.embed.saved_embedding import load_embedding
from planspace.embed.training_log import read_log
from planspace.errors import PlanspaceError
from planspace.mjcf.assets import ASSETS
from planspace.mjcf.read import read_model
from planspace.mjcf.source import ModelFile
from planspace.rl.history import load_history
from planspace.rl.saved_policy import load_policy
from planspace.storage.checkpoint import FILE as CHECKPOINT
from planspace.storage.checkpoint import load_checkpoint, save_checkpoint
from planspace.storage.files import file_hash
from planspace.storage.json_files import read_description, read_sealed, write_sealed
from planspace.tasks.problem_file import load_problem

from .mutations import BYTES, NPZ, PLAIN_JSON, SAFETENSORS, SEALED_JSON, TEXT, Change
from .saved_files import GOLDEN

INFO = StateInfo(("x", "v"), ("m", "m/s"), (), 1)
JSON_PATH = (
    '{"state_dims": ["x", "v", "control", "time"], "path": [[0, 1, 2, 0,], [1, 1, 0, 0.5], [2, 1, 1, 1]]}'
)
CSV = "episode,time,x,v,control1\n0,0,1,2,3\n0,0.5,2,3,\n1,0,1,2,3\n1,0.5,2,3,4\n1,1.1,5,6,\n"
OUT = "0 1\n1 1 2 0.5\n2 1 1 0.25\n"
UNIT = next(path.relative_to(GOLDEN) for path in sorted((GOLDEN / "units").glob("policies-*.json")))


class Loader(NamedTuple):
    """A file, the function that reads it, and the changes made to it."""

    file: Path
    read: Callable[[], object]
    changes: st.SearchStrategy[Change]
    named_by_user: bool = False
    """Whether the user gives the path of the file, which may then be a link."""


def read_changed(data: st.DataObject, loader: Loader) -> None:
    """Read a changed file; it must load or be rejected with one of our errors."""
    change = data.draw(loader.changes)
    original = loader.file.read_bytes()
    loader.file.write_bytes(change(original))
    try:
        loader.read()
        event("read")
    except PlanspaceError as error:
        event("rejected")
        assert str(error).isprintable()
    finally:
        loader.file.write_bytes(original)


def opened(make: Callable[[Path], Loader], folder: Path) -> Iterator[Loader]:
    """Make a loader and read its file once, without waiting for the disk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", "")
        patch.setattr(os, "fsync", lambda _: None)
        loader = make(folder)
        loader.read()
        yield loader


# --- files that are imported or given by the user ----------------------------------------------------


def importer(
    file: Path, content: bytes, changes: st.SearchStrategy[Change], info: StateInfo | None = None
) -> Loader:
    """A file of demonstrations; if its import succeeds, the dataset must load."""
    file.write_bytes(content)
    out = file.parent / "out"

    def read() -> None:
        shutil.rmtree(out, ignore_errors=True)
        import_demos([str(file)], out, info, ImportOptions())
        load_demos(out)

    return Loader(file, read, changes, named_by_user=True)


def make_problem(folder: Path) -> Loader:
    for name in ("arm.xml", "arm.yaml"):
        shutil.copy(ASSETS / name, folder)
    file = folder / "arm.yaml"
    return Loader(file, lambda: load_problem(str(file)), TEXT, named_by_user=True)


def make_model(folder: Path) -> Loader:
    file = Path(shutil.copy(ASSETS / "reacher.xml", folder))
    return Loader(file, lambda: read_model(ModelFile(file, ["joint0"])), TEXT, named_by_user=True)


def make_npz(folder: Path) -> Loader:
    arrays = {"states": np.arange(10.0).reshape(5, 2), "controls": np.zeros((5, 1)), "time": np.arange(5.0)}
    np.savez_compressed(file := io.BytesIO(), **arrays, offsets=np.array([0, 2, 5]))
    return importer(folder / "d.npz", file.getvalue(), NPZ)


def make_minari(folder: Path) -> Loader:
    pytest.importorskip("minari")
    pytest.importorskip("h5py")
    os.environ["MINARI_DATASETS_PATH"] = str(folder / "minari")
    write_minari(load_demos(GOLDEN / "demos"), "a-v0")

    def read() -> None:
        shutil.rmtree(folder / "out", ignore_errors=True)
        import_demos(["minari:a-v0"], folder / "out", None, ImportOptions())

    return Loader(folder / "minari" / "a-v0" / "data" / "metadata.json", read, PLAIN_JSON)


def make_hdf5(folder: Path) -> Loader:
    pytest.importorskip("h5py")
    write_robomimic(load_demos(GOLDEN / "demos"), str(folder / "exported.hdf5"))
    return importer(folder / "d.hdf5", (folder / "exported.hdf5").read_bytes(), BYTES)


# --- files in planspace's folders ----------------------------------------------------------------------


def make_shard(folder: Path) -> Loader:
    shutil.copytree(GOLDEN / "demos", folder / "demos")
    file = folder / "demos" / "shard-00000.safetensors"

    def read() -> None:
        manifest = read_sealed(folder / "demos" / "manifest.json")
        manifest["shards"][0]["sha256"] = file_hash(file)
        write_sealed(folder / "demos" / "manifest.json", manifest)
        load_demos(folder / "demos")

    return Loader(file, read, BYTES | SAFETENSORS)


def make_checkpoint(folder: Path) -> Loader:
    tree = {"a": np.arange(6.0).reshape(2, 3), "b": [np.zeros(2, np.float32), np.array(3)]}
    save_checkpoint(folder, tree, {"step": 3})
    return Loader(folder / CHECKPOINT, lambda: load_checkpoint(folder, tree), BYTES | SAFETENSORS)


def golden(
    name: str, read: Callable[[Path], object], changes: st.SearchStrategy[Change]
) -> Callable[[Path], Loader]:
    """A file of the golden artefacts, and the function that reads its folder."""

    def make(folder: Path) -> Loader:
        copy = shutil.copytree(GOLDEN, folder / "golden")
        file = copy / name
        return Loader(file, lambda: read(file.parent), changes)

    return make


def repairing(name: str, changes: st.SearchStrategy[Change]) -> Callable[[Path], Loader]:
    """A file of the golden artefacts that is repaired instead of read; a second repair must find nothing."""

    def make(folder: Path) -> Loader:
        copy, broken = shutil.copytree(GOLDEN, folder / "golden"), folder / "broken"

        def read() -> None:
            shutil.rmtree(broken, ignore_errors=True)
            shutil.copytree(copy, broken, symlinks=True)
            repair(broken)
            assert repair(broken) == []

        return Loader(copy / name, read, changes)

    return make


def read_unit(units: Path) -> dict[str, Any]:
    return read_description(units / UNIT.name, kind="policies of a study", schema=1)


LOADERS: dict[str, Callable[[Path], Loader]] = {
    "problem": make_problem,
    "model": make_model,
    "npz": make_npz,
    "csv": lambda folder: importer(folder / "d.csv", CSV.encode(), TEXT),
    "json": lambda folder: importer(folder / "d.json", JSON_PATH.encode(), TEXT),
    "out": lambda folder: importer(folder / "d.out", OUT.encode(), TEXT, INFO),
    "minari": make_minari,
    "hdf5": make_hdf5,
    "shard": make_shard,
    "checkpoint": make_checkpoint,
    "manifest": golden("demos/manifest.json", load_demos, SEALED_JSON),
    "embedding": golden("embedding/embedding.json", load_embedding, SEALED_JSON),
    "policies": golden("run/policies.json", load_policy, SEALED_JSON),
    "history": golden("run/history.safetensors", load_history, BYTES | SAFETENSORS),
    "log": golden("embedding/log.jsonl", read_log, TEXT),
    "unit": golden(str(UNIT), read_unit, SEALED_JSON),
}
REPAIRERS: dict[str, Callable[[Path], Loader]] = {
    "manifest": repairing("demos/manifest.json", TEXT | SEALED_JSON),
    "log": repairing("embedding/log.jsonl", TEXT),
    "policies": repairing("run/policies.json", SEALED_JSON),
    "unit": repairing(str(UNIT), TEXT | SEALED_JSON),
}
