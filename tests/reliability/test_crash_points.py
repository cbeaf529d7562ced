"""After any failing disk call, the old or the new state can be read, and a rerun succeeds."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.demos.convert import import_npz
from planspace.demos.dataset import Demos
from planspace.demos.folder import DemoFolder
from planspace.demos.formats.npz import write_npz
from planspace.demos.load import load_demos
from planspace.embed.embedding import Embedding
from planspace.embed.saved_embedding import DESCRIPTION, load_embedding
from planspace.errors import PlanspaceError
from planspace.rl.saved_policy import load_policy, save_policies
from planspace.storage.checkpoint import load_checkpoint, save_checkpoint
from planspace.storage.rows import append_rows, is_row
from planspace.study.execute import _RUN, execute, is_done, read_result
from planspace.study.results import Found, PlansResult
from planspace.study.run import open_results
from planspace.study.unit import PlansUnit

from .disk import FAULTS, Dead, Fault, FaultyDisk, Interrupted

Change = Callable[[Path], None]


@dataclass(frozen=True)
class Artefact:
    """A kind of file, and how it is saved and read."""

    prepare: Change
    """Make the old state."""
    change: Change
    """Save the new state, or continue a change that was interrupted."""
    read: Callable[[Path], Any]
    """What a reader finds; raises if it is damaged."""


def demo_shard(demos: Demos) -> Artefact:
    episodes = [demos.episode(i) for i in range(6)]

    def grow(root: Path, to: int) -> None:
        folder = DemoFolder(root / "demos", demos.info, {"seed": 0})
        if folder.next_index < to:
            folder.append(episodes[folder.next_index : to], next_index=to)

    def read(root: Path) -> str:
        return load_demos(root / "demos").hash

    return Artefact(lambda root: grow(root, 3), lambda root: grow(root, 6), read)


def first_shard(demos: Demos) -> Artefact:
    def change(root: Path) -> None:
        folder = DemoFolder(root / "new" / "demos", demos.info, {"seed": 0})
        if folder.next_index == 0:
            folder.append([demos.episode(0)], next_index=1)

    def read(root: Path) -> str | None:
        path = root / "new" / "demos"
        return load_demos(path).hash if (path / "manifest.json").exists() else None

    return Artefact(lambda root: None, change, read)


def import_artefact(demos: Demos, source: Path) -> Artefact:
    write_npz(demos, str(source))

    def read(root: Path) -> str | None:
        path = root / "imported"
        found = load_demos(path) if (path / "manifest.json").exists() else None
        return None if found is None or len(found) < len(demos) else found.hash

    return Artefact(lambda root: None, lambda root: import_npz(source, root / "imported", None), read)


def embedding_artefact(embedding: Embedding) -> Artefact:
    def change(root: Path) -> None:
        if not (root / "embedding" / DESCRIPTION).exists():
            embedding.save(root / "embedding")

    def read(root: Path) -> str | None:
        path = root / "embedding"
        return load_embedding(path).hash if (path / DESCRIPTION).exists() else None

    return Artefact(lambda root: None, change, read)


def checkpoint() -> Artefact:
    def tree(step: int) -> dict[str, np.ndarray]:
        return {"weights": np.full((8, 3), float(step)), "moments": np.full(8, -1.0 * step)}

    def save(root: Path, step: int) -> None:
        saved = load_checkpoint(root, tree(0))
        if saved is None or saved[1]["step"] < step:
            append_rows(root / "log.jsonl", [{"step": step}], key="step")
            save_checkpoint(root, tree(step), {"step": step})

    def read(root: Path) -> tuple[int, list[int]]:
        saved = load_checkpoint(root, tree(0))
        assert saved is not None
        step = saved[1]["step"]
        for name, array in tree(step).items():
            np.testing.assert_array_equal(saved[0][name], array)
        rows = [json.loads(line) for line in (root / "log.jsonl").read_bytes().splitlines() if is_row(line)]
        return step, [row["step"] for row in rows if row["step"] <= step]  # each row once

    return Artefact(lambda root: save(root, 1), lambda root: save(root, 2), read)


def policies() -> Artefact:
    arrays = {"0.weight": np.ones((1, 1, 2), np.float32), "0.bias": np.zeros((1, 1), np.float32)}
    arrays["log_std"] = np.zeros((1, 1), np.float32)
    about = {"seeds": [0], "returns": [1.0], "layer_norm": False, "columns": [0, 2], "num_obs": 2}
    about |= {"action_low": [-9.0], "action_high": [9.0]}
    about |= {"task": "cartpole", "env_id": "planspace/CartPole-v0"}
    about |= {"obs": "raw", "z": "none", "z_to": "both"}

    def read(root: Path) -> bytes | None:
        if not (root / "policies.json").exists():
            return None
        return load_policy(root)(np.ones(2)).tobytes()

    return Artefact(lambda root: None, lambda root: save_policies(root, arrays, about), read)


def study_unit(demos: Demos) -> Artefact:
    """A unit as a study runs it, with `instant_plans` in place of the planner."""
    unit = PlansUnit("cartpole-swingup", len(demos))

    def change(root: Path) -> None:
        open_results(root / "study")
        execute(unit, root / "study")

    def read(root: Path) -> Found | None:
        return read_result(unit, root / "study").found if is_done(unit, root / "study") else None

    return Artefact(lambda root: None, change, read)


@pytest.fixture
def instant_plans(demos: Demos, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the planner of study units by one that commits given plans in two shards."""

    def run(unit: PlansUnit, folder: Path, out: Path) -> PlansResult:
        dataset = DemoFolder(folder, demos.info, {"seed": unit.seed})
        for index in range(dataset.next_index, unit.num, unit.num // 2):
            to = index + unit.num // 2
            append_rows(folder / "log.jsonl", [{"planned": to}], key="planned")
            dataset.append([demos.episode(i) for i in range(index, to)], next_index=to)
        return PlansResult(dataset.num_episodes, 1.0, 1.0, load_demos(folder).hash)

    monkeypatch.setitem(_RUN, "plans", run)


@pytest.fixture
def artefacts(
    demos: Demos, embedding: Embedding, instant_plans: None, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Artefact]:
    return {
        "demo shard": demo_shard(demos),
        "first demo shard": first_shard(demos),
        "import": import_artefact(demos, tmp_path_factory.mktemp("source") / "demos.npz"),
        "embedding": embedding_artefact(embedding),
        "checkpoint": checkpoint(),
        "policies": policies(),
        "study unit": study_unit(demos),
    }


NAMES = ("demo shard", "first demo shard", "import", "embedding", "checkpoint", "policies", "study unit")
MIN_FAULTS = 400
"""Faults in total that the nightly test must inject."""
injected: set[tuple[str, Fault, int]] = set()


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("import", "study unit")])
def test_a_crash_leaves_the_old_or_the_new_state(
    name: str, artefacts: dict[str, Artefact], tmp_path: Path
) -> None:
    inject_faults(name, artefacts[name], tmp_path, every=5)


@pytest.mark.nightly
@pytest.mark.parametrize("name", NAMES)
def test_every_crash_point_leaves_the_old_or_the_new_state(
    name: str, artefacts: dict[str, Artefact], tmp_path: Path
) -> None:
    injected.update(inject_faults(name, artefacts[name], tmp_path, every=1))


@pytest.mark.nightly
def test_many_faults_were_injected() -> None:
    if {name for name, _, _ in injected} == set(NAMES):
        assert len(injected) >= MIN_FAULTS
        print(f"{len(injected)} faults, no data lost")


def inject_faults(
    name: str, artefact: Artefact, tmp_path: Path, *, every: int
) -> list[tuple[str, Fault, int]]:
    """Inject each fault at every n-th call, in turn at other calls for each fault."""
    before, root = tmp_path / "before", tmp_path / "root"
    before.mkdir()
    artefact.prepare(before)
    old = artefact.read(before)
    shutil.copytree(before, root)
    with FaultyDisk(root) as disk:
        artefact.change(root)
    new, calls = artefact.read(root), disk.calls
    assert new != old and calls >= 10
    points = [(fault, at) for i, fault in enumerate(FAULTS) for at in range(1 + i % every, calls + 1, every)]
    for fault, at in points:
        shutil.rmtree(root)
        shutil.copytree(before, root)
        fail(artefact, root, fault, at)
        assert artefact.read(root) in (old, new), (fault, at)
        artefact.change(root)
        assert artefact.read(root) == new, (fault, at)
    return [(name, fault, at) for fault, at in points]


def fail(artefact: Artefact, root: Path, fault: Fault, at: int) -> None:
    with FaultyDisk(root, fault, at) as disk:
        if fault in ("ENOSPC", "EIO", "short"):
            with pytest.raises(PlanspaceError, match=r"^cannot write .*; free some space or .* again\.$"):
                artefact.change(root)
        else:
            with pytest.raises(Interrupted if fault == "raise" else Dead):
                artefact.change(root)
    assert disk.calls >= at


def test_a_power_failure_after_a_change_does_not_undo_it(
    artefacts: dict[str, Artefact], tmp_path: Path
) -> None:
    for name, artefact in artefacts.items():
        cut, complete = tmp_path / name / "cut", tmp_path / name / "complete"
        for root in (cut, complete):
            root.mkdir(parents=True)
            artefact.prepare(root)
        artefact.change(complete)
        with FaultyDisk(cut, "power") as disk:
            artefact.change(cut)
            disk.cut_power()
        assert artefact.read(cut) == artefact.read(complete), name
