from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace.envs.episodes import TaskEpisodes
from planspace.rl import agent
from planspace.rl.agent import Improvement, Samples, matched, new_agent, values
from planspace.rl.algorithm import Diverged
from planspace.rl.algorithms import PRESETS, find_algorithm
from planspace.rl.algorithms.on_policy import PPO_2020, OnPolicy
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.arm import Arm
from planspace.rl.config import TrainConfig, with_settings
from planspace.rl.critic import LinearCritic, MLPCritic, features
from planspace.rl.observe import Observer
from planspace.rl.policy import UpdateInfo
from planspace.seams import plain_settings
from planspace.tasks.catalog import TASKS

from .test_rollout import roll

TASK = TASKS["cartpole"]


@pytest.fixture(scope="module")
def arm() -> Arm:
    config = TrainConfig(num_seeds=1)
    return Arm(config, Observer(TASK, "raw", "none", "both"), TaskEpisodes(TASK, 4))


def test_the_critic_gives_the_value_where_the_record_is_cut(arm: Arm) -> None:
    rollout = roll(TASK, 4, [0, 1], 20).of_seed(1)
    weights = np.random.default_rng(0).normal(size=12)
    state = new_agent(OnPolicy(), arm, key=jr.key(0))
    state = eqx.tree_at(lambda x: x.critic, state, LinearCritic(weights))
    value, next_value = values(OnPolicy(), state, rollout, arm.observer)
    for t, e in zip(*np.nonzero(rollout.cut), strict=True):
        x = features(rollout.next_obs[t, e], np.array(rollout.step[t, e] + 1))
        assert next_value[t, e] == pytest.approx(x @ weights)
    inner = ~(rollout.terminated | rollout.cut)[:-1]
    np.testing.assert_array_equal(next_value[:-1][inner], value[1:][inner])


def samples_of(
    settings: OnPolicy, arm: Arm, monkeypatch: pytest.MonkeyPatch, gae: Callable[..., np.ndarray]
) -> Samples:
    """The samples that an update with these settings gets, with another function for the advantages."""
    seen = []

    def improve(state: agent.AgentState, samples: Samples, key: jax.Array) -> Improvement:
        seen.append(samples)
        return state.policy, state.optimiser, UpdateInfo(*jnp.zeros(4), jnp.array(1), jnp.array(False))

    monkeypatch.setattr(agent, "gae", gae)
    state = new_agent(settings, arm, key=jr.key(0))
    agent.update(settings, improve, arm, state, roll(TASK, 4, [0], 20).of_seed(0), key=jr.key(1))
    return seen[0]


@pytest.mark.parametrize("normalise", [True, False])
def test_normalised_advantages_do_not_depend_on_a_shift(
    normalise: bool, arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = OnPolicy(normalise_advantages=normalise)
    advantages = np.random.default_rng(0).normal(size=(20, 4))
    a, b = (
        samples_of(settings, arm, monkeypatch, lambda *args, shift=shift, **options: advantages + shift)
        for shift in (0.0, 3.0)
    )
    assert np.allclose(a.advantages, b.advantages, atol=1e-5) == normalise


@pytest.mark.parametrize(("algo", "a_nat"), [("trpo", 0.0), ("ppo", 0.02)])
def test_entropy_is_rewarded(algo: str, a_nat: float, arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    paid = []
    gae = agent.gae
    settings = find_algorithm(algo).on_policy  # pyright: ignore
    samples_of(settings, arm, monkeypatch, lambda *a, **k: paid.append(a[0]) or gae(*a, **k))
    entropy = 0.5 * np.log(2 * np.pi * np.e)  # of a new policy, whose standard deviation is 1
    np.testing.assert_allclose(
        paid[0] - roll(TASK, 4, [0], 20).of_seed(0).rewards, a_nat * entropy, atol=1e-6
    )


@pytest.mark.parametrize(
    ("rate", "scale"), [(1e30, 1.0), (1e-3, 1e25)]
)  # the weights overflow, or Adam's squares
def test_a_ppo_update_with_numbers_that_are_not_finite_raises_diverged(
    rate: float, scale: float, arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    algorithm = PPO(learning_rate=rate)
    advantages = np.random.default_rng(0).normal(size=(20, 4))
    monkeypatch.setattr(agent, "gae", lambda *args, **options: scale * advantages)
    state = algorithm.init(arm, key=jr.key(0))
    with pytest.raises(Diverged):
        algorithm.update(arm, state, roll(TASK, 4, [0], 20).of_seed(0), key=jr.key(1))


def test_a_reward_that_is_not_finite_raises_diverged(arm: Arm) -> None:
    rollout = roll(TASK, 4, [0], 20).of_seed(0)
    rollout.rewards[5, 2] = np.inf
    for algorithm in PRESETS.values():
        with pytest.raises(Diverged):
            algorithm.update(arm, algorithm.init(arm, key=jr.key(0)), rollout, key=jr.key(1))


def test_a_wider_network_has_at_least_as_many_parameters(arm: Arm) -> None:
    # 4 -> 32 -> 32 -> 1: 5 * 32 + 33 * 32 + 33 = 1249; with ten more inputs 1569;
    # 4 -> 36 -> 36 -> 1 has 180 + 1332 + 37 = 1549, too few; with 37 units 185 + 1406 + 38 = 1629
    assert matched((32, 32), 4, 14, 1) == (37, 37)
    assert matched((32, 32), 4, 4, 1) == (32, 32)
    algorithm = with_settings(PPO(PPO_2020), match_z=10)
    state = algorithm.init(arm, key=jr.key(0))
    assert isinstance(state.critic, MLPCritic)
    for network in (state.policy.mean, state.critic.network):
        assert sum(x.size for x in jax.tree.leaves(network)) == 1629


@pytest.mark.parametrize("std", [1.0, 0.2])
def test_a_new_policy_has_the_noise_of_the_settings(std: float, arm: Arm) -> None:
    policy = new_agent(OnPolicy(initial_std=std), arm, key=jr.key(0)).policy
    np.testing.assert_allclose(np.exp(policy.log_std), [std], rtol=1e-6)
    assert ("initial_std" in plain_settings(OnPolicy(initial_std=std))) == (std != 1.0)
