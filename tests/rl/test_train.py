import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace import load_policy
from planspace.cli import main
from planspace.embed.embedding import Embedding, load_embedding
from planspace.envs.batch import TaskBatch
from planspace.errors import PlanspaceError, UsageError
from planspace.rl import train as module
from planspace.rl.config import BATCH_STEPS, Algo, PPOConfig, RLPreset, TrainConfig
from planspace.rl.critic import LinearCritic, MLPCritic, features
from planspace.rl.history import load_history
from planspace.rl.learner import learn, make_learner, matched, values
from planspace.rl.observe import Observer
from planspace.rl.policy import GaussianPolicy
from planspace.rl.rollout import Actor, Rollout, collect, episode_returns, first_returns
from planspace.rl.train import train
from planspace.storage.arrays import read_arrays_and_metadata
from planspace.storage.checkpoint import FILE
from planspace.tasks.catalog import TASKS
from planspace.tasks.task import Task

SWING_UP = TrainConfig("cartpole-swingup", num_seeds=2, steps=3 * BATCH_STEPS)


def fixed_actor(num_seeds: int, num_obs: int, std: float = 1.0) -> Actor:
    zero = jax.tree.map(jnp.zeros_like, GaussianPolicy(num_obs, 1, key=jr.key(0)))
    zero = eqx.tree_at(lambda p: p.log_std, zero, jnp.full(1, np.log(std)))
    return Actor([zero] * num_seeds, slice(None))


def roll(task: Task, num_envs: int, seeds: list[int], num_steps: int) -> Rollout:
    observer = Observer(task, "raw", "none", "both")
    batch = TaskBatch(task, num_envs * len(seeds))
    rngs = [np.random.default_rng(s) for s in seeds]
    return collect(batch, observer, fixed_actor(len(seeds), len(task.fields("raw"))), num_steps, rngs)


def test_a_seeds_episodes_do_not_depend_on_those_beside_it() -> None:
    task = TASKS["cartpole"]  # its episodes end early, so that restarts draw from the streams too
    beside, alone = roll(task, 4, [7, 8, 9], 60), roll(task, 4, [8], 60)
    assert beside.terminated[:, 1].any()
    np.testing.assert_array_equal(beside.obs[:, 1], alone.obs[:, 0])
    np.testing.assert_array_equal(beside.actions[:, 1], alone.actions[:, 0])
    assert (beside.obs[:, 0] != beside.obs[:, 1]).any()


def test_ends_are_told_apart() -> None:
    balance = roll(TASKS["cartpole"], 4, [0], 60)
    assert balance.terminated.any() and not balance.timeout.any()
    assert (balance.cut[-1] == ~balance.terminated[-1]).all() and not balance.cut[:-1].any()
    assert (balance.step[1:][balance.terminated[:-1]] == 0).all()  # the step after an end begins an episode
    swing_up = roll(TASKS["cartpole-swingup"], 2, [0], 200)
    assert swing_up.timeout[-1].all() and not swing_up.timeout[:-1].any()
    assert not (swing_up.terminated.any() or swing_up.cut.any())


def test_returns_count_whole_episodes() -> None:
    rollout = roll(TASKS["cartpole"], 4, [0, 1], 60)
    returns, lengths = episode_returns(rollout)
    np.testing.assert_array_equal(returns, lengths)  # one reward a step
    for s in range(2):
        ends = [np.diff([-1, *np.flatnonzero(rollout.terminated[:, s, e])]) for e in range(4)]
        assert lengths[s] == pytest.approx(np.concatenate(ends).mean())


def test_learns_to_balance(tmp_path: Path) -> None:
    history = train(TrainConfig("cartpole", num_seeds=2, steps=25 * BATCH_STEPS), tmp_path / "run")
    first, last = history["return"][0], history["return"][-1]
    assert (first < 25).all()
    assert (last > 60).all()
    assert (history["kl"] <= 0.01).all() and history["skipped"].sum() <= 2


def test_interrupted_training_ends_bit_for_bit_as_undisturbed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = train(SWING_UP, tmp_path / "whole")
    iterate, calls = module._iterate, []

    def interrupted(*args: object):
        calls.append(args[-1])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return iterate(*args)  # pyright: ignore

    monkeypatch.setattr(module, "_iterate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(SWING_UP, tmp_path / "cut")
    cut = train(SWING_UP, tmp_path / "cut")
    assert calls == [0, 1, 2, 2]  # the iteration that was cut off is done again, nothing else
    for key, expected in whole.items():
        np.testing.assert_array_equal(expected, cut[key])
    assert len((tmp_path / "cut" / "log.jsonl").read_text().splitlines()) == 3


@pytest.mark.parametrize("name", ["append_rows", "save_checkpoint"])
def test_an_interrupt_while_saving_leaves_each_row_once(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work, interrupts = getattr(module, name), []

    def interrupted(*args: object, **options: object) -> None:
        work(*args, **options)
        if not interrupts:
            interrupts.append(KeyboardInterrupt())
            raise interrupts[0]

    monkeypatch.setattr(module, "CHECKPOINT_EVERY", 1)
    monkeypatch.setattr(module, name, interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(SWING_UP, tmp_path)
    assert read_arrays_and_metadata(tmp_path / FILE)[1] == {"iteration": 1}  # nothing that was done is lost
    train(SWING_UP, tmp_path)
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [row["iteration"] for row in rows] == [1, 2, 3]


def test_a_finished_run_is_returned_and_another_refused(tmp_path: Path) -> None:
    config = replace(SWING_UP, steps=1, num_seeds=1)
    first = train(config, tmp_path / "run")
    again = train(config, tmp_path / "run")
    np.testing.assert_array_equal(first["return"], again["return"])
    with pytest.raises(PlanspaceError, match="obs was 'raw', now 'trig'; seed was 0, now 3"):
        train(replace(config, obs="trig", seed=3), tmp_path / "run")


@pytest.mark.parametrize("z_to", ["both", "policy", "critic"])
@pytest.mark.parametrize("z", ["augment", "replace"])
def test_z_goes_where_it_is_sent(embedding: Embedding, z: str, z_to: str, rng: np.random.Generator) -> None:
    task = TASKS["cartpole-swingup"]
    observer = Observer(task, "trig", z, z_to, (embedding,))  # pyright: ignore
    states, targets = task.sample_starts(5, rng)
    obs = observer(states, targets)
    own, latent = task.observe_as("trig", states, targets), embedding.encode(states)
    with_z = latent if z == "replace" else np.concatenate([own, latent], axis=1)
    seen = {"policy": obs[:, observer.policy_columns], "critic": obs[:, observer.critic_columns]}
    for reader, columns in seen.items():
        expected = with_z if z_to in ("both", reader) else own
        np.testing.assert_allclose(columns, expected, atol=1e-5)


def test_arms_with_z_train(embedding: Embedding, tmp_path: Path) -> None:
    config = replace(SWING_UP, obs="trig", z="augment", z_to="policy", steps=BATCH_STEPS)
    assert np.isfinite(train(config, tmp_path / "run", [embedding])["return"]).all()


def test_what_does_not_fit_is_refused(embedding: Embedding, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="z is 'augment', which needs an embedding"):
        train(replace(SWING_UP, z="augment"), tmp_path / "a")
    with pytest.raises(UsageError, match=r"task reacher-raw: .*reads .*\(slider, .*these have 4 \(joint0"):
        train(replace(SWING_UP, task="reacher-raw", z="replace"), tmp_path / "b", [embedding])
    with pytest.raises(UsageError, match="an embedding was given, but z is 'none'"):
        train(SWING_UP, tmp_path / "c", [embedding])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_seeds": 0}, "must be at least 1, got 0 and"),
        ({"seed": -1}, "seeds are at least 0, got -1"),
        ({"eval_every": -1}, "must not be less than 0 iterations apart"),
        ({"obs": "trigg"}, "unknown obs 'trigg'. Did you mean 'trig'?"),
        ({"algo": "sac"}, "unknown algo 'sac'"),
        ({"z_to": "critic"}, "z_to is 'critic', but there is no z"),
        ({"hidden": ()}, "layers of at least one unit"),
        ({"hidden": (32, 0)}, "layers of at least one unit"),
        ({"match_z": -2}, "got match_z = -2"),
        ({"critic": "cubic"}, "unknown critic 'cubic'"),
    ],
)
def test_settings_that_make_no_sense_are_refused(change: dict, message: str) -> None:
    code = "from planspace.rl.config import *; from planspace.errors import UsageError\n"
    of_learner = {"hidden", "match_z", "critic"} & change.keys()
    name = "LearnerConfig(" if of_learner else "TrainConfig('cartpole', "
    code += (
        f"try: {name}**{change!r})\nexcept UsageError as error: print(error)"  # no types are checked there
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert message in done.stdout


def test_iterations_are_of_whole_episodes() -> None:
    assert {name: module.num_episodes(task) for name, task in TASKS.items()} == {
        "cartpole": 40,
        "cartpole-swingup": 20,
        "reacher-trig": 40,
        "reacher-raw": 40,
        "pendulum-swingup": 20,
        "acrobot-swingup": 13,  # of 300 steps: 3900
        "quadrotor-planar": 27,  # of 150: 4050
        "quadrotor": 27,
        "arm": 27,
    }


def test_the_bootstrap_is_the_critics_value_where_the_record_is_cut() -> None:
    task = TASKS["cartpole"]
    rollout = roll(task, 4, [0, 1], 20).of_seed(1)
    observer = Observer(task, "raw", "none", "both")
    weights = np.random.default_rng(0).normal(size=12)
    learner = make_learner(SWING_UP, observer, 1, key=jr.key(0))
    learner = eqx.tree_at(lambda x: x.critic, learner, LinearCritic(weights))
    value, next_value = values(learner, rollout, observer, SWING_UP)
    for t, e in zip(*np.nonzero(rollout.cut), strict=True):
        x = features(rollout.next_obs[t, e], np.array(rollout.step[t, e] + 1))
        assert next_value[t, e] == pytest.approx(x @ weights)
    inner = ~(rollout.terminated | rollout.cut)[:-1]
    np.testing.assert_array_equal(next_value[:-1][inner], value[1:][inner])


ALL_ARMS = [
    {"algo": "trpo", "preset": "paper"},
    {"algo": "trpo", "preset": "modern"},
    {"algo": "ppo", "preset": "paper"},
    {"algo": "ppo", "preset": "modern"},
    {"obs": "trig", "z": "augment"},
    {"z": "replace", "z_to": "critic"},
]


@pytest.mark.parametrize("arm", ALL_ARMS, ids=lambda arm: "-".join(arm.values()))
def test_a_seed_learns_the_same_alone_and_beside_others(
    arm: dict, embedding: Embedding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "BATCH_STEPS", 1000)  # its episodes end at different times
    config = TrainConfig("cartpole", num_seeds=5, steps=3 * BATCH_STEPS, **arm)
    given = [embedding] if config.z != "none" else []
    beside = train(config, tmp_path / "beside", given)
    alone = train(replace(config, seed=3, num_seeds=1), tmp_path / "alone", given)
    for key in (*module.HISTORY_KEYS, module.EVALUATION):
        np.testing.assert_array_equal(beside[key][:, 3], alone[key][:, 0])  # bit for bit
    assert (beside["return"][:, 2] != beside["return"][:, 3]).all()


def test_evaluations_are_apart_from_training(tmp_path: Path) -> None:
    config = replace(SWING_UP, steps=5 * BATCH_STEPS, num_seeds=2)
    often = train(replace(config, eval_every=2), tmp_path / "often")
    assert often["eval_steps"].tolist() == [2 * BATCH_STEPS, 4 * BATCH_STEPS, 5 * BATCH_STEPS]
    assert np.isfinite(often["eval_return"]).all()
    never = train(replace(config, eval_every=0), tmp_path / "never")
    assert never["eval_steps"].tolist() == [5 * BATCH_STEPS]
    for key in module.HISTORY_KEYS:
        np.testing.assert_array_equal(often[key], never[key])
    np.testing.assert_array_equal(often["eval_return"][-1], never["eval_return"][-1])


def test_an_interrupt_in_an_evaluation_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(SWING_UP, eval_every=2)
    whole = train(config, tmp_path / "whole")
    evaluate, calls = module._evaluate, []

    def interrupted(*args: Any) -> Any:
        calls.append(args[-1])
        if len(calls) in (1, 3):
            raise KeyboardInterrupt
        return evaluate(*args)

    monkeypatch.setattr(module, "_evaluate", interrupted)
    for _ in range(2):  # in the first evaluation, and in the last
        with pytest.raises(KeyboardInterrupt):
            train(config, tmp_path / "cut")
    cut = train(config, tmp_path / "cut")
    assert calls == [0, 0, 1, 1]
    for key, expected in whole.items():
        np.testing.assert_array_equal(expected, cut[key])


def test_an_evaluation_is_deterministic_and_the_same_for_every_seed() -> None:
    observer = Observer(TASKS["cartpole-swingup"], "raw", "none", "both", num_seeds=2)
    batch = TaskBatch(observer.task, 2 * 20)
    with ThreadPoolExecutor(1) as threads:
        arm = module._Arm(SWING_UP, observer, batch, threads)
        state = module._init(arm)
        wild = eqx.tree_at(lambda x: x.policy.log_std, state.learners[0], jnp.full(1, 2.0))
        state = state._replace(
            learners=(state.learners[0], wild)
        )  # one policy, two deviations of its actions
        first, second = module._evaluate(arm, state, 0).history[module.EVALUATION][0]
    assert first == second


def test_an_evaluation_that_is_not_finite_is_kept_as_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "first_returns", lambda rollout: np.array([np.nan, -3.0]))
    train(replace(SWING_UP, steps=1), tmp_path / "run")
    policy = load_policy(tmp_path / "run")
    assert policy.about["returns"] == [None, -3.0] and policy.seed == 1


@pytest.mark.parametrize(("algo", "preset", "a_nat"), [("trpo", "paper", 0.0), ("ppo", "paper", 0.02)])
def test_entropy_is_paid_for(
    algo: Algo, preset: RLPreset, a_nat: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: dict[str, Any] = {}
    gae, collected = module.gae, module.collect
    monkeypatch.setattr(module, "gae", lambda *a, **k: kept.update(paid=a[0]) or gae(*a, **k))
    monkeypatch.setattr(module, "collect", lambda *a, **k: kept.setdefault("rollout", collected(*a, **k)))
    train(replace(SWING_UP, algo=algo, preset=preset, steps=1), tmp_path / "run")
    entropy = 0.5 * np.log(2 * np.pi * np.e)  # of the deviation 1 that a policy begins with
    np.testing.assert_allclose(kept["paid"] - kept["rollout"].rewards, a_nat * entropy, atol=1e-9)


@pytest.mark.parametrize("normalised", [True, False])
def test_normalised_advantages_do_not_know_a_shift(normalised: bool) -> None:
    config = TrainConfig("cartpole", "ppo").learning(normalise_advantages=normalised)
    rollout = roll(TASKS["cartpole"], 4, [0], 20).of_seed(0)
    observer = Observer(TASKS["cartpole"], "raw", "none", "both")
    learner = make_learner(config, observer, 1, key=jr.key(0))
    advantages = np.random.default_rng(0).normal(size=(20, 4))
    a, b = (
        learn(learner, rollout, x, advantages, observer, config, key=jr.key(1))[0].policy.mean.weights[0]
        for x in (advantages, advantages + 3.0)
    )
    assert np.allclose(a, b, atol=1e-5) == normalised


def test_an_evaluation_counts_the_first_episode_of_each_environment() -> None:
    rollout = roll(TASKS["cartpole"], 4, [0, 1], 100)
    ends = [[np.flatnonzero(rollout.terminated[:, s, e])[0] + 1 for e in range(4)] for s in range(2)]
    np.testing.assert_array_equal(first_returns(rollout), np.mean(ends, axis=1))  # one reward a step


def test_a_seed_that_diverges_is_frozen_and_the_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "BATCH_STEPS", 1000)
    arguments = ["train", "cartpole", "--seeds", "3", "--steps", "16000"]
    assert main([*arguments, "--out", str(tmp_path / "sound")]) == 0
    collected, calls = module.collect, []

    def poisoned(*args: Any, **kwargs: Any) -> Rollout:
        rollout = collected(*args, **kwargs)
        calls.append(None)
        if len(calls) == 3:
            rollout.rewards[5, 1, 2] = np.inf
        return rollout

    monkeypatch.setattr(module, "collect", poisoned)
    assert main([*arguments, "--out", str(tmp_path / "poisoned")]) == 3
    assert "seed 1 diverged in iteration 3: numbers that are not finite" in capsys.readouterr().err
    sound, frozen = load_history(tmp_path / "sound"), load_history(tmp_path / "poisoned")
    np.testing.assert_array_equal(frozen["frozen"][:, 1], [0, 0, 1, 1])
    assert not frozen["frozen"][:, [0, 2]].any()
    for key in set(module.HISTORY_KEYS) - {"frozen"}:
        np.testing.assert_array_equal(frozen[key][:, [0, 2]], sound[key][:, [0, 2]])
    assert np.isfinite(frozen["return"][3, 1]) and frozen["skipped"][3, 1] == 1
    assert main([*arguments, "--out", str(tmp_path / "poisoned")]) == 3  # the finished run says so again


@pytest.mark.parametrize(("rate", "scale"), [(1e30, 1.0), (1e-3, 1e25)])  # weights, Adam's squares overflow
def test_an_update_of_ppo_that_is_not_finite_freezes_the_seed(rate: float, scale: float) -> None:
    config = TrainConfig("cartpole", "ppo").learning(ppo=PPOConfig(learning_rate=rate))
    rollout = roll(TASKS["cartpole"], 4, [0], 20).of_seed(0)
    observer = Observer(TASKS["cartpole"], "raw", "none", "both")
    learner = make_learner(config, observer, 1, key=jr.key(0))
    advantages = np.random.default_rng(0).normal(size=(20, 4))
    new, numbers = learn(learner, rollout, scale * advantages, advantages, observer, config, key=jr.key(1))
    assert new.frozen and numbers["skipped"] == 1
    assert eqx.tree_equal(new.policy, learner.policy)


def test_embeddings_are_taken_in_turn(embedding: Embedding, tmp_path: Path) -> None:
    other = replace(embedding, encoder=(embedding.encoder[0], [-b for b in embedding.encoder[1]]))
    assert other.hash != embedding.hash
    config = replace(SWING_UP, z="augment", steps=BATCH_STEPS, num_seeds=3, seed=1)
    mixed = train(config, tmp_path / "mixed", [embedding, other])
    for i, used in enumerate((other, embedding, other)):  # seeds 1, 2 and 3
        alone = train(replace(config, seed=1 + i, num_seeds=1), tmp_path / f"alone-{i}", [used])
        np.testing.assert_array_equal(mixed["return"][:, i], alone["return"][:, 0])
    assert load_policy(tmp_path / "mixed", 2).embedding == tmp_path / "mixed" / "embedding-0"
    assert load_embedding(load_policy(tmp_path / "mixed", 3).embedding).hash == other.hash
    with pytest.raises(UsageError, match="3 embeddings are too many for 2 seeds"):
        train(replace(config, num_seeds=2), tmp_path / "few", [embedding] * 3)
    with pytest.raises(PlanspaceError, match="embeddings was"):
        train(config, tmp_path / "mixed", [other, embedding])


def test_a_wider_network_has_as_many_parameters() -> None:
    # 4 -> 32 -> 32 -> 1: 5 * 32 + 33 * 32 + 33 = 1249; with ten more inputs 1569;
    # 4 -> 36 -> 36 -> 1: 180 + 1332 + 37 = 1549 is too few; 37: 185 + 1406 + 38 = 1629
    assert matched((32, 32), 4, 14, 1) == (37, 37)
    assert matched((32, 32), 4, 4, 1) == (32, 32)
    observer = Observer(TASKS["cartpole"], "raw", "none", "both")
    config = TrainConfig("cartpole", "ppo").learning(match_z=10)
    learner = make_learner(config, observer, 1, key=jr.key(0))
    assert isinstance(learner.critic, MLPCritic)
    for network in (learner.policy.mean, learner.critic.network):
        assert sum(x.size for x in jax.tree.leaves(network)) == 1629


def test_curves_are_tracked(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    history = train(replace(SWING_UP, eval_every=2), tmp_path / "run", track=("tensorboard",))
    accumulator = EventAccumulator(str(tmp_path / "run" / "tensorboard"))
    accumulator.Reload()
    returns = [(e.step, e.value) for e in accumulator.Scalars("return/seed 1")]
    assert returns == [(4000 * (i + 1), np.float32(history["return"][i, 1])) for i in range(3)]
    evaluations = [(e.step, e.value) for e in accumulator.Scalars("eval_return/seed 0")]
    expected = zip(history["eval_steps"], history["eval_return"][:, 0], strict=True)
    assert evaluations == [(n, np.float32(x)) for n, x in expected]
