"""From every checkpoint on, everything ends the same, bit for bit; and without any part of it, it does not.

There are no random keys and no states of environments in a checkpoint: both follow from the seed and the
number of the iteration (of the step, for an embedding), since every iteration plays whole episodes.
"""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed import training as embed_training
from planspace.embed.fit import fit
from planspace.errors import PlanspaceError
from planspace.rl import train as rl_training
from planspace.rl.config import BATCH_STEPS, Algo, RLPreset, TrainConfig
from planspace.store import read_arrays

from ..conftest import QUICK_FIT

Run = Callable[[Path], Any]
Ending = dict[str, Any]


def ending(folder: Path) -> Ending:
    """All that a run leaves, apart from times of day."""
    files = [*folder.glob("*.safetensors"), folder / "checkpoint" / "state.safetensors"]
    left: Ending = {f"{f.name}: {k}": v.tobytes() for f in files for k, v in read_arrays(f).items()}
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    clocks = {"saved", "time", "date", "seconds"}
    for row in rows:
        left[f"row {row.get('iteration', row.get('step'))}"] = {k: row[k] for k in row.keys() - clocks}
    return left


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


ARMS: list[tuple[Algo, RLPreset]] = [
    ("trpo", "paper"),
    ("trpo", "modern"),
    ("ppo", "modern"),
]


@pytest.mark.parametrize(("algo", "preset"), ARMS)
def test_policies(algo: Algo, preset: RLPreset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rl_training, "BATCH_STEPS", 1000)
    monkeypatch.setattr(rl_training, "CHECKPOINT_EVERY", 1)
    config = TrainConfig("cartpole", algo, preset=preset, num_seeds=2, steps=3 * BATCH_STEPS, eval_every=1)
    tested = set(assert_exact(lambda out: rl_training.train(config, out), rl_training, tmp_path))
    expected = {".learners.policy.mean.weights", ".learners.policy.mean.biases", ".learners.policy.log_std"}
    expected |= {f".history['{key}']" for key in ("return", "length", "kl", "entropy", "loss", "eval_return")}
    if (algo, preset) == ("trpo", "paper"):
        expected |= {".learners.critic.weights"}
    else:
        network = ("network.weights", "network.biases", "mean", "deviation")
        expected |= {f".learners.critic.{name}" for name in network}
    if algo == "ppo":
        expected |= {f".learners.adam.{m}.mean.weights" for m in ("mu", "nu")} | {".learners.adam.count"}
    if preset == "modern":
        expected |= {f".learners.statistics.{name}" for name in ("num", "mean", "squares")}
    assert tested >= expected, expected - tested


def test_an_embedding(demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embed_training, "CHUNK", 20)
    config = replace(QUICK_FIT, steps=60, batch=16).changed(average=0.9)

    def run(out: Path) -> None:
        fit(demos, out, config=config, num_seeds=2, seed=3)

    tested = set(assert_exact(run, embed_training, tmp_path))
    networks = ("model", "average", "optimiser.mu", "optimiser.nu")
    parts = ("encode.weights", "encode.biases", "decode.weights", "decode.biases")
    assert tested == {".optimiser.count", *(f".{n}.{part}" for n in networks for part in parts)}


def test_a_frozen_seed_stays_frozen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What no undisturbed run has, so that no mutant above could drop it."""
    monkeypatch.setattr(rl_training, "BATCH_STEPS", 1000)
    monkeypatch.setattr(rl_training, "CHECKPOINT_EVERY", 1)
    save = rl_training.save_checkpoint

    def freeze(folder: Path, tree: Any, about: dict[str, Any]) -> None:
        save(folder, eqx.tree_at(lambda t: t.learners[1].frozen, tree, np.array(True)), about)
        raise KeyboardInterrupt

    config = TrainConfig("cartpole", num_seeds=2, steps=3 * BATCH_STEPS)
    monkeypatch.setattr(rl_training, "save_checkpoint", freeze)
    with pytest.raises(KeyboardInterrupt):
        rl_training.train(config, tmp_path)
    monkeypatch.setattr(rl_training, "save_checkpoint", save)
    assert rl_training.train(config, tmp_path)["frozen"][1:].tolist() == [[0.0, 1.0], [0.0, 1.0]]


def test_the_number_of_the_iteration_is_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Random streams follow from it."""
    monkeypatch.setattr(rl_training, "BATCH_STEPS", 1000)
    monkeypatch.setattr(rl_training, "CHECKPOINT_EVERY", 1)
    config = TrainConfig("cartpole", num_seeds=2, steps=3 * BATCH_STEPS)

    def run(out: Path) -> None:
        rl_training.train(config, out)

    whole, copies = checkpoints(run, rl_training, tmp_path)
    load = rl_training.load_checkpoint

    def forget(folder: Path, like: Any) -> Any:
        return load(folder, like)[0], {"iteration": 0}

    monkeypatch.setattr(rl_training, "load_checkpoint", forget)
    run(copies[-1])
    assert ending(copies[-1]) != whole
