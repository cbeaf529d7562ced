import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace import load_policy
from planspace.cli import main
from planspace.embed.embedding import Embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.errors import PlanspaceError, UsageError
from planspace.rl import arm as arm_module
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.rl.history import EVALUATION, load_history
from planspace.rl.play import play
from planspace.rl.rollout import Rollout
from planspace.rl.training import train_policies

TASK = "cartpole-swingup"
CONFIG = TrainConfig(num_seeds=2, steps=3 * BATCH_STEPS)


@pytest.mark.nightly
def test_trpo_learns_to_balance() -> None:
    trained = train_policies("cartpole", TrainConfig(num_seeds=2, steps=25 * BATCH_STEPS))
    history = trained.history
    first, last = history["return"][0], history["return"][-1]
    assert (first < 25).all()
    assert (last > 60).all()
    assert (history["kl"] <= 0.01).all() and history["skipped"].sum() <= 2


def test_a_finished_run_is_loaded_and_other_settings_are_refused(tmp_path: Path) -> None:
    config = replace(CONFIG, steps=1, num_seeds=1)
    first = train_policies(TASK, config, out=tmp_path / "run").history
    again = train_policies(TASK, config, out=tmp_path / "run").history
    np.testing.assert_array_equal(first["return"], again["return"])
    with pytest.raises(PlanspaceError, match="obs was 'raw', now 'trig'; seed was 0, now 3"):
        train_policies(TASK, replace(config, obs="trig", seed=3), out=tmp_path / "run")
    with pytest.raises(PlanspaceError, match=r"algorithm\.max_kl was 0\.01, now 0\.02"):
        train_policies(TASK, config.with_hyperparameters(max_kl=0.02), out=tmp_path / "run")


def test_a_finished_run_without_policies_makes_them_again(tmp_path: Path) -> None:
    config, run = replace(CONFIG, steps=1, num_seeds=1), tmp_path / "run"
    before = train_policies(TASK, config, out=run).policy()(np.ones((3, 4), np.float32))
    for name in ("policies.json", "policies.safetensors"):
        (run / name).unlink()
    train_policies(TASK, config, out=run)
    np.testing.assert_array_equal(load_policy(run)(np.ones((3, 4), np.float32)), before)


def test_an_embedding_can_be_given_by_its_folder(embedding_folder: Path, tmp_path: Path) -> None:
    config, run = replace(CONFIG, steps=1, num_seeds=1, z="augment"), tmp_path / "run"
    train_policies(TASK, config, embedding=embedding_folder, out=run)
    config = replace(config, num_seeds=2)
    with pytest.raises(PlanspaceError, match="num_seeds was 1, now 2"):
        train_policies(TASK, config, embedding=[str(embedding_folder)], out=run)


def test_an_embedding_that_was_replaced_is_noticed(embedding: Embedding, tmp_path: Path) -> None:
    config, run = replace(CONFIG, steps=1, num_seeds=1, z="augment"), tmp_path / "run"
    train_policies(TASK, config, embedding=embedding, out=run)
    play(load_policy(run), 1, 0)
    shutil.rmtree(run / "embedding")
    replace(embedding, about=None, sigma_floor=2.0 * embedding.sigma_floor).save(run / "embedding")
    with pytest.raises(PlanspaceError, match="it was replaced"):
        play(load_policy(run), 1, 0)


@pytest.mark.slow
def test_in_memory_policies_outlive_their_training(embedding: Embedding) -> None:
    config = replace(CONFIG, steps=1, z="augment")
    trained = train_policies(TASK, config, embedding=embedding, verbose=False)
    run, policy = trained.run, trained.policy(1)
    assert policy.seed == 1 and trained.policy().seed in (0, 1)
    lines = repr(trained).splitlines()
    assert lines[0] == "TrainedPolicies: cartpole-swingup, trpo, 2 seeds, 4,000 steps" and len(lines) == 4
    assert trained._repr_html_().count("<tr>") == 3
    assert [row.seed for row in trained.returns] == [0, 1]
    del trained
    assert load_embedding(policy.embedding).hash == embedding.hash
    del policy
    assert not run.exists()


def test_wrong_combinations_of_task_and_embedding_are_refused(embedding: Embedding, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="z is 'augment', which needs an embedding"):
        train_policies(TASK, replace(CONFIG, z="augment"), out=tmp_path / "a")
    with pytest.raises(UsageError, match=r"task reacher-raw: .*reads .*\(slider, .*these have 4 \(joint0"):
        train_policies("reacher-raw", replace(CONFIG, z="replace"), embedding=embedding, out=tmp_path / "b")
    with pytest.raises(UsageError, match="an embedding was given, but z is 'none'"):
        train_policies(TASK, CONFIG, embedding=embedding, out=tmp_path / "c")
    with pytest.raises(UsageError, match="unknown task 'swingup'. Did you mean"):
        train_policies("swingup", CONFIG, out=tmp_path / "d")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_seeds": 0}, "`num_seeds` must be at least 1, got 0"),
        ({"seed": -1}, "`seed` must be at least 0, got -1"),
        ({"seed": 2**32 - 2}, "`seed` must be at most 4294967291, as JAX knows 2^32 seeds, got 4294967294"),
        ({"steps": "5"}, "`steps` must be a whole number, got '5'"),
        ({"clone": 10.5}, "`clone` must be a whole number, got 10.5"),
        ({"eval_every": -1}, "`eval_every` must be at least 0, got -1"),
        ({"obs": "trigg"}, "unknown obs 'trigg'. Did you mean 'trig'?"),
        ({"algorithm": 3}, "An Algorithm needs the methods act, collect, init, update; 3 has no act"),
        ({"z_to": "critic"}, "z_to is 'critic', but there is no z"),
        ({"hidden": ()}, "`hidden` needs at least one unit in each layer"),
        ({"hidden": (32, 0)}, "`hidden` needs at least one unit in each layer"),
        ({"match_z": -2}, "`match_z` must be at least 0 and finite, got -2"),
        ({"critic": "cubic"}, "unknown critic 'cubic'"),
    ],
)
def test_settings_out_of_range_are_refused(change: dict, message: str) -> None:
    code = "from planspace.rl.config import *; from planspace.rl.algorithms.on_policy import OnPolicy\n"
    name = "OnPolicy" if {"hidden", "match_z", "critic"} & change.keys() else "TrainConfig"
    code += (
        f"try: {name}(**{change!r})\nexcept UsageError as error: print(error)"  # types are not checked there
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert message in done.stdout


QUICK_ARMS: list[dict[str, Any]] = [{"algorithm": ("trpo", "paper")}, {"obs": "trig", "z": "augment"}]
SLOW_ARMS: list[dict[str, Any]] = [{"z": "replace", "z_to": "critic"}]
LONG_ARMS: list[dict[str, Any]] = [
    {"algorithm": (name, preset)}
    for name, preset in (("ppo", "modern"), ("trpo", "modern"), ("ppo", "paper"))
]
ARMS = [
    *QUICK_ARMS,
    *(pytest.param(arm, marks=pytest.mark.slow) for arm in SLOW_ARMS),
    *(pytest.param(arm, marks=pytest.mark.nightly) for arm in LONG_ARMS),
]


@pytest.mark.parametrize("arm", ARMS, ids=str)
def test_a_seed_does_not_depend_on_the_other_seeds(arm: dict, embedding: Embedding) -> None:
    arm = {name: find_algorithm(*value) if name == "algorithm" else value for name, value in arm.items()}
    config = TrainConfig(num_seeds=5, steps=3000, batch_steps=1000, **arm)  # episodes of different lengths
    given = embedding if config.z != "none" else None
    together = train_policies("cartpole", config, embedding=given).history
    single = train_policies("cartpole", replace(config, seed=3, num_seeds=1), embedding=given).history
    for key in together.keys() - {"steps", "eval_steps"}:
        np.testing.assert_array_equal(together[key][:, 3], single[key][:, 0])  # bit for bit
    assert (together["return"][:, 2] != together["return"][:, 3]).all()


@pytest.mark.slow
def test_a_diverging_seed_is_frozen_and_the_others_continue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["train", "cartpole", "--seeds", "3", "--steps", "16000"]
    assert main([*arguments, "--out", str(tmp_path / "sound")]) == 0
    collect, calls = arm_module.collect, []

    def poisoned(*args: Any, **options: Any) -> Rollout:
        rollout = collect(*args, **options)
        calls.append(None)
        if len(calls) == 3:
            rollout.rewards[5, 1, 2] = np.inf
        return rollout

    monkeypatch.setattr(arm_module, "collect", poisoned)
    assert main([*arguments, "--out", str(tmp_path / "poisoned")]) == 3
    assert "seed 1 diverged and was frozen with the policy that it had" in capsys.readouterr().err
    sound, frozen = load_history(tmp_path / "sound"), load_history(tmp_path / "poisoned")
    np.testing.assert_array_equal(frozen["frozen"][:, 1], [0, 0, 1, 1])
    assert not frozen["frozen"][:, [0, 2]].any()
    for key in sound.keys() - {"frozen", "steps", "eval_steps"}:
        np.testing.assert_array_equal(frozen[key][:, [0, 2]], sound[key][:, [0, 2]])
    assert np.isfinite(frozen["return"][3, 1]) and np.isnan(frozen["kl"][2:, 1]).all()
    assert np.isfinite(frozen[EVALUATION]).all()  # a frozen seed acts with its last policy
    assert main([*arguments, "--out", str(tmp_path / "poisoned")]) == 3  # a finished run reports it again


@pytest.mark.nightly
def test_seeds_take_embeddings_in_turn(embedding: Embedding, tmp_path: Path) -> None:
    other = replace(embedding, encoder=(embedding.encoder[0], [-b for b in embedding.encoder[1]]))
    assert other.hash != embedding.hash
    config = replace(CONFIG, z="augment", steps=BATCH_STEPS, num_seeds=3, seed=1)
    mixed = train_policies(TASK, config, embedding=[embedding, other], out=tmp_path / "mixed").history
    for i, used in enumerate((other, embedding, other)):  # seeds 1, 2 and 3
        single = train_policies(TASK, replace(config, seed=1 + i, num_seeds=1), embedding=used).history
        np.testing.assert_array_equal(mixed["return"][:, i], single["return"][:, 0])
    assert load_policy(tmp_path / "mixed", 2).embedding == tmp_path / "mixed" / "embedding-0"
    assert load_embedding(load_policy(tmp_path / "mixed", 3).embedding).hash == other.hash
    with pytest.raises(UsageError, match="3 embeddings are too many for 2 seeds"):
        train_policies(TASK, replace(config, num_seeds=2), embedding=[embedding] * 3, out=tmp_path / "few")
    with pytest.raises(PlanspaceError, match="embeddings was"):
        train_policies(TASK, config, embedding=[other, embedding], out=tmp_path / "mixed")


def test_curves_are_tracked(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    config = replace(CONFIG, eval_every=2)
    history = train_policies(TASK, config, out=tmp_path / "run", track=("tensorboard",)).history
    accumulator = EventAccumulator(str(tmp_path / "run" / "tensorboard"))
    accumulator.Reload()
    returns = [(e.step, e.value) for e in accumulator.Scalars("return/seed 1")]
    assert returns == [(4000 * (i + 1), np.float32(history["return"][i, 1])) for i in range(3)]
    evaluations = [(e.step, e.value) for e in accumulator.Scalars("eval_return/seed 0")]
    expected = zip(history["eval_steps"], history["eval_return"][:, 0], strict=True)
    assert evaluations == [(n, np.float32(x)) for n, x in expected]
