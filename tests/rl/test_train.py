from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace.embed.embedding import Embedding
from planspace.envs.batch import TaskBatch
from planspace.errors import PlanspaceError, UsageError
from planspace.rl import critic
from planspace.rl import train as module
from planspace.rl.config import BATCH_STEPS, LearnerConfig, TrainConfig
from planspace.rl.normalise import ObsStatistics
from planspace.rl.observe import Observer
from planspace.rl.policy import GaussianPolicy
from planspace.rl.rollout import Actor, Rollout, collect, episode_returns
from planspace.rl.train import train
from planspace.tasks import TASKS, Task

SWING_UP = TrainConfig("cartpole-swingup", num_seeds=2, steps=3 * BATCH_STEPS)


def fixed_actor(num_seeds: int, num_obs: int, std: float = 1.0) -> Actor:
    zero = jax.tree.map(jnp.zeros_like, GaussianPolicy(num_obs, 1, key=jr.key(0)))
    zero = eqx.tree_at(lambda p: p.log_std, zero, jnp.full(1, np.log(std)))
    return Actor(jax.tree.map(lambda x: jnp.stack([x] * num_seeds), zero), slice(None))


def roll(task: Task, num_envs: int, seeds: list[int], num_steps: int) -> Rollout:
    observer = Observer(task, "raw", "none", "both", None)
    batch = TaskBatch(task, num_envs * len(seeds))
    rngs = [np.random.default_rng(s) for s in seeds]
    return collect(batch, observer, fixed_actor(len(seeds), len(task.obs_fields)), num_steps, rngs)


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
    for key, values in whole.items():
        np.testing.assert_array_equal(values, cut[key])
    assert len((tmp_path / "cut" / "log.jsonl").read_text().splitlines()) == 3


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
    observer = Observer(task, "trig", z, z_to, embedding)  # pyright: ignore
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
    assert np.isfinite(train(config, tmp_path / "run", embedding)["return"]).all()


def test_what_does_not_fit_is_refused(embedding: Embedding, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="z is 'augment', which needs an embedding"):
        train(replace(SWING_UP, z="augment"), tmp_path / "a")
    with pytest.raises(UsageError, match=r"task reacher-raw: .*reads .*\(slider, .*these have 4 \(joint0"):
        train(replace(SWING_UP, task="reacher-raw", z="replace"), tmp_path / "b", embedding)
    with pytest.raises(UsageError, match="must be at least 1, got 0 and"):
        replace(SWING_UP, num_seeds=0)
    assert list(tmp_path.iterdir()) == []


def test_the_bootstrap_is_the_critics_value_where_the_record_is_cut() -> None:
    task = TASKS["cartpole"]
    rollout = roll(task, 4, [0, 1], 20)
    observer = Observer(task, "raw", "none", "both", None)
    weights = np.random.default_rng(0).normal(size=(2, 12))
    obs, linear = module._per_seed(rollout.obs), critic.LinearCritic(weights)
    statistics, learner = ObsStatistics.empty(2, 4), LearnerConfig()
    value, next_value = module._values(rollout, observer, linear, obs, statistics, learner)
    for t, s, e in zip(*np.nonzero(rollout.cut), strict=True):
        x = critic.features(rollout.next_obs[t, s, e], np.array(rollout.step[t, s, e] + 1))
        assert next_value[t, s, e] == pytest.approx(x @ weights[s])
    inner = ~(rollout.terminated | rollout.cut)[:-1]
    np.testing.assert_array_equal(next_value[:-1][inner], value[1:][inner])
