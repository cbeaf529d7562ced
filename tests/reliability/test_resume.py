"""A run resumed from any checkpoint ends the same, bit for bit; without any part of a checkpoint it does not.

A checkpoint holds no random keys and no states of environments: both follow from the seed and the number of
the iteration (for an embedding, of the step), because every iteration plays whole episodes.
"""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.folder import DemoFolder
from planspace.demos.load import load_demos
from planspace.demos.manifest import MANIFEST
from planspace.embed import training as embed_training
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.errors import PartialResult, PlanspaceError
from planspace.plan import demonstrations
from planspace.plan.demonstrations import plan_into
from planspace.rl import training as rl_training
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig, ZMode
from planspace.rl.training import train_policies
from planspace.storage.arrays import read_arrays
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.tasks.problem_file import load_problem

from ..conftest import QUICK_FIT, QUICK_PLANNER

Run = Callable[[Path], Any]
Ending = dict[str, Any]
LOG = "log"


def ending(folder: Path) -> Ending:
    """Everything that a run leaves, without times of day."""
    files = [*folder.glob("*.safetensors"), folder / "checkpoint" / "state.safetensors"]
    left: Ending = {f"{f.name}: {k}": v.tobytes() for f in files for k, v in read_arrays(f).items()}
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    clocks = {"saved", "time", "date", "seconds"}
    return left | {LOG: [{k: row[k] for k in row.keys() - clocks} for row in rows]}


def results(left: Ending) -> Ending:
    """Without the log, whose rows differ if a run starts again from its first step."""
    return {name: value for name, value in left.items() if name != LOG}


def checkpoints(run: Run, module: ModuleType, tmp_path: Path) -> tuple[Ending, list[Path]]:
    """Run undisturbed, and copy the folder after each checkpoint except the last."""
    copies: list[Path] = []
    save = module.save_checkpoint

    def keep(folder: Path, tree: object, counters: dict[str, int]) -> None:
        save(folder, tree, counters)
        copies.append(tmp_path / f"after-{len(copies) + 1}")
        shutil.copytree(folder, copies[-1])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "save_checkpoint", keep)
        run(tmp_path / "whole")
    return ending(tmp_path / "whole"), copies[:-1]


def items(folder: Path) -> list[str]:
    """The kinds of arrays in a checkpoint; layers and seeds count as one."""
    names = read_arrays(folder / "checkpoint" / "state.safetensors")
    return sorted({item_of(name) for name in names})


def item_of(name: str) -> str:
    return re.sub(r"\[\d+\]", "", name)


def ending_without(item: str, run: Run, module: ModuleType, copy: Path, to: Path) -> Ending | None:
    """How a run ends if one kind of array is not restored; None if it still had its initial value."""
    load, lost = module.load_checkpoint, False

    def forget(folder: Path, like: Any) -> Any:
        nonlocal lost
        tree, counters = load(folder, like)

        def choose(path: Any, fresh: Any, saved: Any) -> Any:
            nonlocal lost
            if item_of(jax.tree_util.keystr(path)) != item or not hasattr(fresh, "shape"):
                return saved
            if isinstance(fresh, jax.ShapeDtypeStruct):
                fresh = np.zeros(fresh.shape, fresh.dtype)
            lost |= not np.array_equal(np.asarray(fresh), np.asarray(saved), equal_nan=True)
            return fresh

        return jax.tree_util.tree_map_with_path(choose, like, tree), counters

    shutil.copytree(copy, to)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "load_checkpoint", forget)
        try:
            run(to)
        except PlanspaceError as error:  # training may diverge
            return {"error": str(error)}
    return ending(to) if lost else None


def assert_exact(run: Run, module: ModuleType, tmp_path: Path) -> Iterator[str]:
    """Resume from every checkpoint, then without each kind of array; yield the kinds that were tested."""
    whole, copies = checkpoints(run, module, tmp_path)
    assert len(copies) >= 2
    for copy in copies:
        resumed = shutil.copytree(copy, tmp_path / f"resumed-{copy.name}")
        run(resumed)
        assert ending(resumed) == whole, copy.name
    for number, item in enumerate(items(copies[-1])):
        without = ending_without(item, run, module, copies[-1], tmp_path / f"without-{number}")
        if without is not None:
            assert without != whole, f"{item} is saved, but not needed"
            yield item


ARMS = [
    pytest.param("trpo", "paper", "none", marks=pytest.mark.slow),
    pytest.param("trpo", "modern", "augment", marks=pytest.mark.nightly),
    pytest.param("ppo", "paper", "augment", marks=pytest.mark.nightly),
    pytest.param("ppo", "modern", "none", marks=pytest.mark.nightly),
]


SHORT = TrainConfig(num_seeds=2, steps=3000, batch_steps=1000)


@pytest.fixture
def frequent_checkpoints(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save a checkpoint after every iteration."""
    monkeypatch.setattr(rl_training, "CHECKPOINT_EVERY", 1)


@pytest.mark.parametrize(("algo", "preset", "z"), ARMS)
@pytest.mark.usefixtures("frequent_checkpoints")
def test_policies(algo: str, preset: str, z: ZMode, embedding: Embedding, tmp_path: Path) -> None:
    config = replace(SHORT, algorithm=find_algorithm(algo, preset), z=z, eval_every=1)
    given = embedding if z != "none" else None
    run = lambda out: train_policies("cartpole", config, embedding=given, out=out)  # noqa: E731
    tested = set(assert_exact(run, rl_training, tmp_path))
    expected = {".agents.policy.mean.weights", ".agents.policy.mean.biases", ".agents.policy.log_std"}
    expected |= {f".history['{key}']" for key in ("return", "length", "kl", "entropy", "loss", "eval_return")}
    if (algo, preset) == ("trpo", "paper"):
        expected |= {".agents.critic.weights"}
    else:
        network = ("network.weights", "network.biases", "mean", "std")
        expected |= {f".agents.critic.{name}" for name in network}
    if algo == "ppo":
        expected |= {f".agents.optimiser.{m}.mean.weights" for m in ("mu", "nu")} | {
            ".agents.optimiser.count"
        }
    if preset == "modern":
        expected |= {f".agents.statistics.{name}" for name in ("num", "mean", "squares")}
    assert tested >= expected, expected - tested


@pytest.fixture
def train_embedding(demos: Demos, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Function that trains an embedding with three checkpoints."""
    monkeypatch.setattr(embed_training, "CHUNK", 20)
    config = replace(QUICK_FIT, steps=60, batch=16, average=0.9)
    return lambda out: fit_embedding(demos, config=config, out=out, num_seeds=2, seed=3)


@pytest.mark.nightly
def test_an_embedding(train_embedding: Run, tmp_path: Path) -> None:
    tested = set(assert_exact(train_embedding, embed_training, tmp_path))
    networks = ("model", "average", "optimiser.mu", "optimiser.nu")
    parts = ("encode.weights", "encode.biases", "decode.weights", "decode.biases")
    assert tested == {".optimiser.count", *(f".{n}.{part}" for n in networks for part in parts)}


@pytest.mark.usefixtures("frequent_checkpoints")
@pytest.mark.slow
def test_a_frozen_seed_stays_frozen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An undisturbed run has no frozen seed, so the tests above do not cover it."""
    save = rl_training.save_checkpoint

    def freeze(folder: Path, tree: Any, counters: dict[str, int]) -> None:
        save(folder, tree._replace(frozen=np.array([False, True])), counters)
        raise KeyboardInterrupt

    monkeypatch.setattr(rl_training, "save_checkpoint", freeze)
    with pytest.raises(KeyboardInterrupt):
        train_policies("cartpole", SHORT, out=tmp_path)
    monkeypatch.setattr(rl_training, "save_checkpoint", save)
    assert train_policies("cartpole", SHORT, out=tmp_path).history["frozen"][1:].tolist() == [
        [0.0, 1.0],
        [0.0, 1.0],
    ]


# --- the counter and the log -------------------------------------------------------------------------


def assert_counter_and_log_matter(run: Run, module: ModuleType, number: str, tmp_path: Path) -> None:
    """Assert that a run ends differently without its counter, and keeps its results without its log."""
    whole, copies = checkpoints(run, module, tmp_path)
    rowless = shutil.copytree(copies[-1], tmp_path / "rowless")
    (rowless / "log.jsonl").unlink()
    run(rowless)
    assert results(ending(rowless)) == results(whole) and ending(rowless) != whole
    load = module.load_checkpoint
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "load_checkpoint", lambda folder, like: (load(folder, like)[0], {number: 0}))
        run(copies[-1])
    assert results(ending(copies[-1])) != results(whole)


@pytest.mark.usefixtures("frequent_checkpoints")
def test_the_iteration_counter_matters(tmp_path: Path) -> None:
    assert_counter_and_log_matter(
        lambda out: train_policies("cartpole", SHORT, out=out), rl_training, "iteration", tmp_path
    )


@pytest.mark.slow
def test_the_step_counter_of_an_embedding_matters(train_embedding: Run, tmp_path: Path) -> None:
    assert_counter_and_log_matter(train_embedding, embed_training, "step", tmp_path)


@pytest.mark.nightly
def test_plans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The manifest of a dataset is its checkpoint: its shards and the next index."""
    monkeypatch.setattr(demonstrations, "SHARD_EPISODES", 2)
    problem, copies, append = load_problem("cartpole-swingup"), [], DemoFolder.append

    def keep(folder: DemoFolder, *args: Any) -> None:
        append(folder, *args)
        copies.append(shutil.copytree(folder.path, tmp_path / f"after-{len(copies) + 1}"))

    def run(out: Path) -> Ending:
        with suppress(PartialResult):  # reports that some plans are missing
            plan_into(problem, out, num=6, seed=0, config=QUICK_PLANNER, workers=0)
        rows = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
        return {"hash": load_demos(out).hash, LOG: [row["planned"] for row in rows]}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DemoFolder, "append", keep)
        whole = run(tmp_path / "whole")
    assert len(copies) == 3
    for copy in copies[:-1]:
        for lost in ({"shards": []}, {"next_index": 0}):
            without = shutil.copytree(copy, tmp_path / f"{copy.name} without {next(iter(lost))}")
            write_sealed(without / MANIFEST, read_sealed(without / MANIFEST) | lost)
            assert run(without)["hash"] != whole["hash"]
        assert run(copy) == whole
