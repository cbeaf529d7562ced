from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from planspace.embed.gaussian import kl
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.policy import GaussianPolicy
from planspace.rl.policy_network import Actor
from planspace.rl.trpo_update import conjugate_gradient, fisher_product, update

CONFIG = TRPO()


@pytest.fixture
def policy() -> GaussianPolicy:
    return GaussianPolicy(3, 2, key=jr.key(0))


@pytest.fixture
def batch(policy: GaussianPolicy) -> tuple[jax.Array, jax.Array, jax.Array]:
    obs = jr.normal(jr.key(1), (400, 3))
    keys = jr.split(jr.key(2), 400)
    actions = jax.vmap(lambda o, k: policy(o).sample(key=k))(obs, keys)
    advantages = actions[:, 0] * obs[:, 0]  # rewards a first action with the sign of the first observation
    return obs, actions, (advantages - advantages.mean()) / advantages.std()


def unchecked(name: str, value: float) -> TRPO:
    """Settings with a value that `TRPO` refuses, to reach cases that data rarely cause."""
    config = replace(CONFIG)
    object.__setattr__(config, name, value)
    return config


def mean_kl(old: GaussianPolicy, new: GaussianPolicy, obs: jax.Array) -> float:
    return float(jnp.mean(jax.vmap(lambda o: kl(old(o), new(o)))(obs)))


@pytest.mark.slow
def test_fisher_product_is_the_hessian_of_the_kl() -> None:
    policy = GaussianPolicy(3, 2, hidden=(6, 6), key=jr.key(0))
    obs = jr.normal(jr.key(1), (20, 3))
    theta, rebuild = ravel_pytree(policy)
    hessian = jax.hessian(lambda t: jnp.mean(jax.vmap(lambda o: kl(policy(o), rebuild(t)(o)))(obs)))(theta)
    product = fisher_product(rebuild, theta, obs)
    for key in jr.split(jr.key(3), 3):
        v = jr.normal(key, theta.shape)
        np.testing.assert_allclose(product(v), hessian @ v, rtol=1e-3, atol=1e-4)


def test_conjugate_gradient_solves_a_linear_system(rng: np.random.Generator) -> None:
    root = rng.normal(size=(8, 8))
    a, b = jnp.asarray(root @ root.T + 8 * np.eye(8)), jnp.asarray(rng.normal(size=8))
    x = conjugate_gradient(lambda v: a @ v, b, 10)
    np.testing.assert_allclose(x, np.linalg.solve(a, b), rtol=1e-3, atol=1e-5)


@pytest.mark.slow
def test_an_update_improves_within_the_trust_region(policy: GaussianPolicy, batch: tuple) -> None:
    new, info = update(policy, *batch, CONFIG)
    moved = mean_kl(policy, new, batch[0])
    assert not info.skipped and float(info.improvement) > 0
    assert float(info.kl) == pytest.approx(moved, rel=1e-2)
    assert 0.3 * CONFIG.max_kl < moved <= CONFIG.max_kl
    probe = jnp.array([1.0, 0.0, 0.0])
    assert float(new(probe).mu[0]) > float(policy(probe).mu[0])  # towards rewarded actions


@pytest.mark.slow
def test_a_failed_line_search_leaves_the_policy_unchanged(policy: GaussianPolicy, batch: tuple) -> None:
    new, info = update(policy, *batch, unchecked("max_kl", -1.0))  # a KL cannot be negative
    assert info.skipped
    assert eqx.tree_equal(new, policy)
    assert float(info.kl) == 0.0 and int(info.rounds) == CONFIG.max_backtracks


@pytest.mark.slow
def test_curvature_that_is_not_positive_skips_the_update(policy: GaussianPolicy, batch: tuple) -> None:
    new, info = update(policy, *batch, unchecked("cg_damping", -100.0))
    assert info.skipped and int(info.rounds) == 1
    assert eqx.tree_equal(new, policy)


@pytest.mark.parametrize("poison", [jnp.nan, jnp.inf])
def test_numbers_that_are_not_finite_skip_the_update(
    policy: GaussianPolicy, batch: tuple, poison: float
) -> None:
    obs, actions, advantages = batch
    new, info = update(policy, obs, actions, advantages.at[3].set(poison), CONFIG)
    assert info.skipped
    assert eqx.tree_equal(new, policy)


def test_without_advantages_the_policy_does_not_change(policy: GaussianPolicy, batch: tuple) -> None:
    new, info = update(policy, batch[0], batch[1], jnp.zeros(400), CONFIG)
    assert info.skipped
    assert eqx.tree_equal(new, policy)


def test_the_actor_computes_the_policys_actions(rng: np.random.Generator) -> None:
    policies = [GaussianPolicy(3, 2, key=jr.key(s)) for s in range(2)]
    obs = rng.normal(size=(2, 5, 3)).astype(np.float32)
    actor, noise = Actor([p.network() for p in policies]), rng.normal(size=(2, 5, 2))
    means, actions = actor(obs, np.zeros((2, 5, 2))), actor(obs, noise)
    for s, policy in enumerate(policies):
        np.testing.assert_allclose(means[s], jax.vmap(lambda o, p=policy: p(o).mu)(obs[s]), atol=1e-5)
        np.testing.assert_allclose(actions[s] - means[s], noise[s] * np.exp(policy.log_std), atol=1e-5)
