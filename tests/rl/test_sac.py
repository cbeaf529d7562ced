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
from planspace.envs.episodes import TaskEpisodes
from planspace.errors import PlanspaceError, UsageError
from planspace.rl import training
from planspace.rl.algorithms.sac import SAC
from planspace.rl.arm import Arm
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.rl.export import export_policies
from planspace.rl.observe import Observer
from planspace.rl.policy_network import Actor
from planspace.rl.run_setup import with_algorithm
from planspace.rl.sac_agent import SACState, _with_more
from planspace.rl.sac_update import Batch, critic_targets, new_learner
from planspace.rl.training import train_policies
from planspace.rl.transitions import Transitions
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.tasks.catalog import TASKS

from .test_own_algorithm import aim

SMALL = SAC(hidden=(16,), critic_hidden=(16, 16), batch=32, updates_per_step=0.05)
MODERN = replace(SMALL, layer_norm=True, normalise_obs=True)
TASK = TASKS["cartpole-swingup"]


def make_arm(settings: SAC = SMALL, num_seeds: int = 1, **changes: Any) -> Arm:
    """The swing-up, with two environments per seed."""
    config = TrainConfig(settings, num_seeds=num_seeds, steps=1200, batch_steps=400, **changes)
    return Arm(config, Observer(TASK, "raw", "none", "both"), TaskEpisodes(TASK, 2 * num_seeds))


def after_one_iteration(arm: Arm, settings: SAC, change: Any = lambda rollout: None) -> tuple:
    """The rollout of the only seed, its state after an update, and the numbers of the update."""
    state = settings.init(arm, key=jr.key(0))
    rollout = settings.collect(arm, [state], [np.random.default_rng(0)]).of_seed(0)
    change(rollout)
    return rollout, *settings.update(arm, state, rollout, key=jr.key(1))


@pytest.mark.nightly
def test_a_resumed_run_and_a_single_seed_are_exact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = replace(MODERN, replay_size=700)  # 1200 steps: the oldest are replaced
    config = TrainConfig(settings, num_seeds=3, steps=1200, batch_steps=400, eval_every=1)
    run = lambda out, config=config: train_policies(TASK, config, out=tmp_path / out).history  # noqa: E731
    whole = run("whole")
    monkeypatch.setattr(training, "CHECKPOINT_EVERY", 1)
    update, calls = SAC.update, []

    def interrupted(self: SAC, *args: Any, **options: Any) -> Any:
        calls.append(None)
        if len(calls) == 8:
            raise KeyboardInterrupt
        return update(self, *args, **options)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(SAC, "update", interrupted)
        run("cut")
    resumed, alone = run("cut"), run("alone", replace(config, seed=1, num_seeds=1))
    for name in whole.keys() - {"steps", "eval_steps"}:
        np.testing.assert_array_equal(whole[name], resumed[name])
        np.testing.assert_array_equal(whole[name][:, 1], alone[name][:, 0])
    assert np.isfinite(whole["critic_loss"]).all() and not whole["frozen"].any()


@pytest.mark.nightly
def test_the_known_best_action_is_found() -> None:
    task = replace(aim(), start_low=(-1.0, -1.0, 1.0, 0.0), start_high=(1.0, 1.0, 1.0, 0.0))
    config = TrainConfig(
        replace(MODERN, updates_per_step=1.0, learning_rate=3e-3, temperature=0.1), num_seeds=1
    )
    trained = train_policies(task, replace(config, steps=3000, batch_steps=200, eval_every=0))
    assert trained.history["eval_return"][-1, 0] > -4.0  # of 20 steps; random actions earn -80
    np.testing.assert_allclose(trained.policy(0)(np.array([0.0, 0.0, 1.0, 0.0], np.float32)), 1.0, atol=0.5)


def test_values_count_beyond_the_time_limit_but_not_beyond_a_termination() -> None:
    learner = new_learner(SMALL, 2, 2, 1, key=jr.key(0))
    obs, actions, rewards = jnp.ones((3, 2)), jnp.zeros((3, 1)), jnp.array([1.0, 2.0, 6.0])
    targets, value = eqx.filter_jit(critic_targets), {}
    for terminated in (True, False):
        batch = Batch(obs, obs, actions, rewards, obs, obs, jnp.full(3, terminated))
        value[terminated] = targets(SMALL, learner, batch, jnp.zeros((3, 1))).mean()
    mean, log_std = learner.actor(obs[0])
    action = jnp.tanh(mean)
    # log N(mean; mean, std) - log(1 - a^2), at temperature 1
    log_prob = -log_std - 0.5 * jnp.log(2 * jnp.pi) - jnp.log(1 - action**2)
    inputs = jnp.concatenate([obs[0], action[None]])
    q = min(critic(inputs)[0] for critic in learner.critics)
    assert value[True] == pytest.approx(3.0)
    assert value[False] == pytest.approx(float(3.0 + 0.99 * (q - log_prob)), rel=1e-4)
    rollout, state, _ = after_one_iteration(make_arm(), SMALL)
    assert rollout.timeout.any() and not state.replay.terminated.any()


def test_the_first_actions_are_uniform() -> None:
    arm, settings = make_arm(num_seeds=2), replace(SMALL, learning_starts=200)
    states = [settings.init(arm, key=jr.key(seed)) for seed in range(2)]
    certain = lambda s: s.learner.actor.biases[-1]  # noqa: E731
    states[1] = eqx.tree_at(certain, states[1], jnp.array([50.0, -50.0]))  # always the upper limit, 3
    rollout = settings.collect(arm, states, [np.random.default_rng(seed) for seed in range(2)])
    first = rollout.actions[:100].ravel()  # two environments, 200 steps
    np.testing.assert_allclose(np.quantile(first, [0, 0.25, 0.5, 0.75, 1]), [-3, -1.5, 0, 1.5, 3], atol=0.4)
    np.testing.assert_array_equal(rollout.actions[100:, 1], 3.0)
    assert len(np.unique(rollout.actions[100:, 0])) > 100 and np.abs(rollout.actions).max() <= 3.0


def test_the_replay_replaces_the_oldest_rows() -> None:
    def rows(numbers: list[float]) -> Transitions:
        column = np.array(numbers, np.float32)
        return Transitions(column[:, None], column[:, None], column, column[:, None], column > 0)

    empty = rows([0, 0, 0, 0])
    three = _with_more(empty, rows([1, 2, 3]), 0)
    assert three.rewards.tolist() == [1, 2, 3, 0] and not empty.rewards.any()
    assert _with_more(three, rows([4, 5, 6]), 3).rewards.tolist() == [5, 6, 3, 4]
    assert sorted(_with_more(three, rows([4, 5, 6, 7, 8, 9]), 3).obs[:, 0].tolist()) == [6, 7, 8, 9]


@pytest.mark.slow
def test_a_fraction_of_each_batch_comes_from_plans() -> None:
    def pay_nothing(rollout: Any) -> None:
        rollout.rewards[:], rollout.terminated[:] = 0.0, True

    num = 5
    plans = Transitions(
        obs=np.zeros((num, 4), np.float32),
        actions=np.zeros((num, 1), np.float32),
        rewards=np.ones(num),
        next_obs=np.zeros((num, 4), np.float32),
        terminated=np.ones(num, bool),
    )
    arm = replace(make_arm(replay=0.25), plan_transitions=plans)
    assert after_one_iteration(arm, SMALL, pay_nothing)[2]["value"] == pytest.approx(0.25)
    assert after_one_iteration(make_arm(), SMALL, pay_nothing)[2]["value"] == 0.0


def test_nothing_is_updated_before_learning_starts() -> None:
    settings = replace(SMALL, learning_starts=400)
    arm = make_arm(settings)
    _, state, numbers = after_one_iteration(arm, settings)
    assert isinstance(state, SACState) and state.num_steps == 400 and np.isnan(list(numbers.values())).all()
    same = jax.tree.map(np.array_equal, state.learner, settings.init(arm, key=jr.key(0)).learner)
    assert all(jax.tree.leaves(same))


def test_the_default_of_batch_steps_is_the_algorithms() -> None:
    assert TrainConfig().batch_steps == BATCH_STEPS == 4000
    assert TrainConfig(SAC()).batch_steps == 1000
    change = with_algorithm
    assert change(TrainConfig(), "sac").batch_steps == 1000
    assert change(TrainConfig(batch_steps=600), "sac").batch_steps == 600


def test_actions_without_limits_are_refused() -> None:
    with pytest.raises(UsageError, match="SAC needs limits of all actions, and cartpole-swingup with the"):
        train_policies(TASK, TrainConfig(SMALL, num_seeds=1, steps=1, reward="2020"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"activation": "gelu"}, "activation is 'gelu'"),
        ({"squashed": 1}, "squashed is 1"),
        ({"action_low": [None]}, "squashed between limits that are missing"),
        ({"schema": 3}, "newer planspace"),
    ],
)
def test_a_saved_policy_acts_the_same_and_damage_is_refused(
    change: dict, message: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    arm = make_arm()
    state = SMALL.init(arm, key=jr.key(3))
    network = SMALL.act(arm, state)
    export_policies(tmp_path, arm, [network], [], [0.0])
    obs = 3 * rng.normal(size=(1, 7, 4)).astype(np.float32)
    wanted = Actor([network])(obs, np.zeros((1, 7, 1)))[0]
    means = jax.vmap(state.learner.actor)(obs[0])[:, :1]
    np.testing.assert_allclose(wanted, 3.0 * np.tanh(means), atol=1e-5)
    np.testing.assert_array_equal(load_policy(tmp_path)(obs[0]), wanted)
    description = read_sealed(tmp_path / "policies.json")
    assert description["schema"] == 2
    write_sealed(tmp_path / "policies.json", description | change)
    with pytest.raises(PlanspaceError, match=message):
        load_policy(tmp_path)
