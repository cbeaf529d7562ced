from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from planspace.rl import ppo_update as ppo
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.policy import GaussianPolicy

CONFIG = PPO(minibatch=50, of_steps=True, tolerance=0.0)


@pytest.fixture
def policy() -> GaussianPolicy:
    return GaussianPolicy(3, 1, key=jr.key(0))


@pytest.fixture
def batch(policy: GaussianPolicy) -> ppo.Batch:
    obs = jr.normal(jr.key(1), (120, 3))
    actions = jax.vmap(lambda o, k: policy(o).sample(key=k))(obs, jr.split(jr.key(2), 120))
    return ppo.Batch(obs, actions, actions[:, 0] * obs[:, 0], policy.log_prob(obs, actions))


def run(policy: GaussianPolicy, batch: ppo.Batch, config: PPO, seed: int = 0):
    adam = ppo.optimiser(config).init(eqx.filter(policy, eqx.is_array))
    return ppo.update(policy, adam, batch, config, key=jr.key(seed))


def test_the_loss_by_hand(policy: GaussianPolicy, batch: ppo.Batch) -> None:
    # ratios 2 and 0.5, clipped to 1.2 and 0.8, for advantages 1 and -1:
    # min(2, 1.2), min(-2, -1.2), min(0.5, 0.8), min(-0.5, -0.8): the mean of 1.2, -2, 0.5, -0.8 is -0.275
    log_ratio = jnp.log(jnp.array([2.0, 2.0, 0.5, 0.5]))
    four = jax.tree.map(lambda x: x[:4], batch)
    four = eqx.tree_at(lambda b: b.log_prob, four, four.log_prob - log_ratio)
    four = eqx.tree_at(lambda b: b.advantages, four, jnp.array([1.0, -1.0, 1.0, -1.0]))
    assert float(ppo.loss(policy, four, 0.2)) == pytest.approx(0.275, rel=1e-4)


def test_an_update_moves_the_policy_towards_rewarded_actions(
    policy: GaussianPolicy, batch: ppo.Batch
) -> None:
    new, _, info = run(policy, batch, CONFIG)
    assert not info.skipped and float(info.improvement) > 0 and int(info.rounds) == CONFIG.epochs
    assert float(info.loss) == pytest.approx(float(ppo.loss(new, batch, CONFIG.clip)))
    probe = jnp.array([1.0, 0.0, 0.0])
    assert float(new(probe).mu[0]) > float(policy(probe).mu[0])  # towards rewarded actions


def test_each_epoch_uses_every_sample_once(
    policy: GaussianPolicy, batch: ppo.Batch, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(CONFIG, minibatch=50)  # minibatches of 50, 50 and 20
    numbered = eqx.tree_at(lambda b: b.obs, batch, jnp.arange(120.0)[:, None] * jnp.ones(3))
    counting = eqx.tree_at(lambda p: p.log_std, policy, jnp.zeros(120))

    def count(policy: GaussianPolicy, adam: tuple, batch: ppo.Batch, *_: object) -> tuple:
        seen = policy.log_std.at[batch.obs[:, 0].astype(int)].add(1.0)
        return eqx.tree_at(lambda p: p.log_std, policy, seen), adam

    monkeypatch.setattr(ppo, "minibatch_step", count)
    counted, _ = ppo._epoch(counting, (), numbered, config, key=jr.key(3))
    np.testing.assert_array_equal(counted.log_std, 1.0)


@pytest.mark.slow
def test_minibatches_of_trajectories_equal_minibatches_of_steps(
    policy: GaussianPolicy, batch: ppo.Batch
) -> None:
    """If one minibatch contains all steps, their grouping makes no difference."""
    config = replace(CONFIG, minibatch=120)
    folded = ppo.Batch(
        batch.obs.reshape(8, 15, 3),
        batch.actions.reshape(8, 15, 1),
        batch.advantages.reshape(8, 15),
        batch.log_prob.reshape(8, 15),
    )
    flat, whole = run(policy, batch, config)[0], run(policy, folded, config)[0]
    np.testing.assert_allclose(ravel_pytree(flat)[0], ravel_pytree(whole)[0], atol=1e-4)


@pytest.mark.slow
def test_an_update_stops_when_the_loss_is_constant(policy: GaussianPolicy, batch: ppo.Batch) -> None:
    _, _, info = run(policy, batch, replace(CONFIG, tolerance=1e3))
    assert int(info.rounds) == 2  # the first epoch has no loss before it to compare with
    still = eqx.tree_at(lambda b: b.advantages, batch, jnp.zeros(120))
    assert int(run(policy, still, replace(CONFIG, tolerance=1e-6))[2].rounds) == 2


@pytest.mark.parametrize("poison", [jnp.nan, jnp.inf])
def test_numbers_that_are_not_finite_leave_the_policy_unchanged(
    policy: GaussianPolicy, batch: ppo.Batch, poison: float
) -> None:
    broken = eqx.tree_at(lambda b: b.advantages, batch, batch.advantages.at[3].set(poison))
    new, adam, info = run(policy, broken, CONFIG)
    assert info.skipped
    assert eqx.tree_equal(new, policy)
    assert eqx.tree_equal(adam, ppo.optimiser(CONFIG).init(eqx.filter(policy, eqx.is_array)))
