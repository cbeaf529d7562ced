"""Every kind of file that planspace saves, and the function that reads it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from planspace.demos.load import load_demos
from planspace.embed.saved_embedding import load_embedding
from planspace.errors import PlanspaceError
from planspace.rl.history import load_history
from planspace.rl.saved_policy import load_policy
from planspace.storage.arrays import read_arrays_and_metadata
from planspace.storage.json_files import read_sealed
from planspace.study.execute import folder_of, read_result, result_file

from ..tiny_study import FIT, PLANS, policy

GOLDEN = Path(__file__).parents[1] / "golden" / "2026-11"
POLICY = policy(0, z=True)
Readers = dict[Path, Callable[[], Any]]


def readers_of_golden(folder: Path) -> Readers:
    """The files in a copy of the golden artefacts."""
    demos, embedding, run = (folder / name for name in ("demos", "embedding", "run"))
    return {
        demos / "manifest.json": lambda: load_demos(demos),
        demos / "shard-00000.safetensors": lambda: load_demos(demos),
        embedding / "embedding.json": lambda: load_embedding(embedding),
        embedding / "embedding.safetensors": lambda: load_embedding(embedding),
        run / "policies.json": lambda: load_policy(run),
        run / "policies.safetensors": lambda: load_policy(run),
        run / "history.safetensors": lambda: load_history(run),
        **{file: lambda file=file: read_sealed(file) for file in sorted((folder / "units").glob("*.json"))},
    }


def readers_of_study(out: Path) -> Readers:
    """The files that the tiny study leaves, with its checkpoints and two shards of demonstrations."""
    plans, fitted, trained = (folder_of(unit, out) for unit in (PLANS, FIT, POLICY))
    files: Readers = {}
    for name in ("manifest.json", "shard-00000.safetensors", "shard-00001.safetensors"):
        files[plans / name] = lambda: load_demos(plans)
    for name in ("embedding.json", "embedding.safetensors"):
        files[fitted / name] = lambda: load_embedding(fitted)
    for name in ("policies.json", "policies.safetensors"):
        files[trained / name] = lambda: load_policy(trained)
    files[trained / "history.safetensors"] = lambda: load_history(trained)
    for folder in (fitted, trained):
        path = folder / "checkpoint" / "state.safetensors"
        files[path] = lambda path=path: read_arrays_and_metadata(path)
    for unit in (PLANS, FIT, POLICY):
        files[result_file(unit, out)] = lambda unit=unit: read_result(unit, out)
    return files


def assert_found(file: Path, read: Callable[[], Any], damage: object) -> None:
    """Assert that reading a damaged file fails, and that the message names the file and the repair."""
    try:
        read()
    except PlanspaceError as error:
        assert str(file) in str(error) and "planspace repair" in str(error), (damage, str(error))
        return
    raise AssertionError(f"{file.name}, {damage}: not found")
