"""From every checkpoint on, everything ends the same, bit for bit; and without any part of it, it does not.

There are no random keys and no states of environments in a checkpoint: both follow from the seed and the
number of the iteration (of the step, for an embedding), since every iteration plays whole episodes.
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
    """All that a run leaves, apart from times of day."""
    files = [*folder.glob("*.safetensors"), folder / "checkpoint" / "state.safetensors"]
    left: Ending = {f"{f.name}: {k}": v.tobytes() for f in files for k, v in read_arrays(f).items()}
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    clocks = {"saved", "time", "date", "seconds"}
    return left | {LOG: [{k: row[k] for k in row.keys() - clocks} for row in rows]}


def results(left: Ending) -> Ending:
    """Without the log, which tells a rerun from its first step already by its rows."""
    return {name: value for name, value in left.items() if name != LOG}


def checkpoints(run: Run, module: ModuleType, tmp_path: Path) -> tuple[Ending, list[Path]]:
    """Runs undisturbed, keeping the folder as it was after each checkpoint but the last."""
    copies: list[Path] = []
    save = module.save_checkpoint

    def keep(folder: Path, tree: object, about: dict[str, Any]) -> None:
        save(folder, tree, about)
        copies.append(tmp_path / f"after-{len(copies) + 1}")
        shutil.copytree(folder, copies[-1])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "save_checkpoint", keep)
        run(tmp_path / "whole")
    return ending(tmp_path / "whole"), copies[:-1]


def items(folder: Path) -> list[str]:
    """The kinds of things in a checkpoint; layers and seeds of one kind go together."""
    names = read_arrays(folder / "checkpoint" / "state.safetensors")
    return sorted({item_of(name) for name in names})


def item_of(name: str) -> str:
    return re.sub(r"\[\d+\]", "", name)


def ending_without(item: str, run: Run, module: ModuleType, copy: Path, to: Path) -> Ending | None:
    """How it ends where one thing is not restored; None where that was as at the beginning."""
    load, lost = module.load_checkpoint, False

    def forget(folder: Path, like: Any) -> Any:
        nonlocal lost
        tree, about = load(folder, like)

        def choose(path: Any, fresh: Any, saved: Any) -> Any:
            nonlocal lost
            if item_of(jax.tree_util.keystr(path)) != item or not hasattr(fresh, "shape"):
                return saved
            if isinstance(fresh, jax.ShapeDtypeStruct):
                fresh = np.zeros(fresh.shape, fresh.dtype)
            lost |= not np.array_equal(np.asarray(fresh), np.asarray(saved), equal_nan=True)
            return fresh

        return jax.tree_util.tree_map_with_path(choose, like, tree), about

    shutil.copytree(copy, to)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "load_checkpoint", forget)
        try:
            run(to)
        except PlanspaceError as error:  # it may diverge
            return {"error": str(error)}
    return ending(to) if lost else None


def assert_exact(run: Run, module: ModuleType, tmp_path: Path) -> Iterator[str]:
    """Resumes from every checkpoint, then without each item; yields the items that were put to the test."""
    whole, copies = checkpoints(run, module, tmp_path)
    assert len(copies) >= 2
    for copy in copies:
        resumed = shutil.copytree(copy, tmp_path / f"resumed-{copy.name}")
        run(resumed)
        assert ending(resumed) == whole, copy.name
    for number, item in enumerate(items(copies[-1])):
        without = ending_without(item, run, module, copies[-1], tmp_path / f"without-{number}")
        if without is not None:
            assert without != whole, f"{item} is saved, but nobody misses it"
            yield item


ARMS: list[tuple[str, str, ZMode]] = [
    ("trpo", "paper", "none"),
    ("trpo", "modern", "augment"),
    ("ppo", "paper", "augment"),
    ("ppo", "modern", "none"),
]


SHORT = TrainConfig(num_seeds=2, steps=3000, batch_steps=1000)


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint after every iteration."""
    monkeypatch.setattr(rl_training, "CHECKPOINT_EVERY", 1)


@pytest.mark.parametrize(("algo", "preset", "z"), ARMS)
@pytest.mark.usefixtures("often")
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
        network = ("network.weights", "network.biases", "mean", "deviation")
        expected |= {f".agents.critic.{name}" for name in network}
    if algo == "ppo":
        expected |= {f".agents.optimiser.{m}.mean.weights" for m in ("mu", "nu")} | {
            ".agents.optimiser.count"
        }
    if preset == "modern":
        expected |= {f".agents.statistics.{name}" for name in ("num", "mean", "squares")}
    assert tested >= expected, expected - tested


@pytest.fixture
def briefly(demos: Demos, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Trains an embedding with three checkpoints."""
    monkeypatch.setattr(embed_training, "CHUNK", 20)
    config = replace(QUICK_FIT, steps=60, batch=16, average=0.9)
    return lambda out: fit_embedding(demos, config=config, out=out, num_seeds=2, seed=3)


def test_an_embedding(briefly: Run, tmp_path: Path) -> None:
    tested = set(assert_exact(briefly, embed_training, tmp_path))
    networks = ("model", "average", "optimiser.mu", "optimiser.nu")
    parts = ("encode.weights", "encode.biases", "decode.weights", "decode.biases")
    assert tested == {".optimiser.count", *(f".{n}.{part}" for n in networks for part in parts)}


@pytest.mark.usefixtures("often")
def test_a_frozen_seed_stays_frozen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What no undisturbed run has, so that no mutant above could drop it."""
    save = rl_training.save_checkpoint

    def freeze(folder: Path, tree: Any, about: dict[str, Any]) -> None:
        save(folder, tree._replace(frozen=np.array([False, True])), about)
        raise KeyboardInterrupt

    monkeypatch.setattr(rl_training, "save_checkpoint", freeze)
    with pytest.raises(KeyboardInterrupt):
        train_policies("cartpole", SHORT, out=tmp_path)
    monkeypatch.setattr(rl_training, "save_checkpoint", save)
    assert train_policies("cartpole", SHORT, out=tmp_path).history["frozen"][1:].tolist() == [
        [0.0, 1.0],
        [0.0, 1.0],
    ]


# --- what stands beside the arrays -------------------------------------------------------------------


def assert_number_and_log_are_missed(run: Run, module: ModuleType, number: str, tmp_path: Path) -> None:
    """How far it had come, from which random streams follow, and the rows until then."""
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


@pytest.mark.usefixtures("often")
def test_the_iteration_of_a_training_is_missed(tmp_path: Path) -> None:
    assert_number_and_log_are_missed(
        lambda out: train_policies("cartpole", SHORT, out=out), rl_training, "iteration", tmp_path
    )


def test_the_step_of_an_embedding_is_missed(briefly: Run, tmp_path: Path) -> None:
    assert_number_and_log_are_missed(briefly, embed_training, "step", tmp_path)


def test_plans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A dataset's manifest is its checkpoint: its shards, and how far it had come."""
    monkeypatch.setattr(demonstrations, "SHARD_EPISODES", 2)
    problem, copies, append = load_problem("cartpole-swingup"), [], DemoFolder.append

    def keep(folder: DemoFolder, *args: Any) -> None:
        append(folder, *args)
        copies.append(shutil.copytree(folder.path, tmp_path / f"after-{len(copies) + 1}"))

    def run(out: Path) -> Ending:
        with suppress(PartialResult):  # says that some are missing
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
