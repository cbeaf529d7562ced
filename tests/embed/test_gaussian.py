import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy.stats

from planspace.embed.gaussian import DiagonalGaussian, kl, kl_to_prior
from planspace.embed.networks import GaussianNetwork

P = DiagonalGaussian(jnp.array([0.5, -1.0]), jnp.array([0.7, 2.0]))
Q = DiagonalGaussian(jnp.array([0.0, 1.0]), jnp.array([1.5, 0.4]))


def test_log_prob_against_scipy() -> None:
    x = np.array([0.2, 0.3])
    expected = scipy.stats.norm(np.asarray(P.mu), np.asarray(P.sigma)).logpdf(x).sum()
    assert float(P.log_prob(jnp.asarray(x))) == pytest.approx(expected, rel=1e-5)


def test_kl_by_hand_and_kl_of_equal_distributions() -> None:
    # one dimension, N(1, 2) to N(0, 1): log(1/2) + (4 + 1) / 2 - 1/2 = 2 - log 2
    one = DiagonalGaussian(jnp.array([1.0]), jnp.array([2.0]))
    assert float(kl_to_prior(one)) == pytest.approx(2 - np.log(2), rel=1e-6)
    assert float(kl(P, P)) == pytest.approx(0.0, abs=1e-6)


def test_kl_equals_its_monte_carlo_estimate() -> None:
    x = jax.vmap(lambda k: P.sample(key=k))(jr.split(jr.key(0), 40_000))
    estimate = jnp.mean(jax.vmap(P.log_prob)(x) - jax.vmap(Q.log_prob)(x))
    assert float(kl(P, Q)) == pytest.approx(float(estimate), rel=0.03)
    assert float(kl(P, Q)) != pytest.approx(float(kl(Q, P)), rel=0.03)  # KL is not symmetric


def test_a_tiny_standard_deviation_does_not_round_to_zero() -> None:
    network = GaussianNetwork(1, 3, (), 0.0, key=jr.key(0))
    rho = jnp.array([-30.0, -11.0, -0.5])  # the sum exp(x) - 1 + 1 is 0 in float32 for the first
    biases = [jnp.concatenate([jnp.zeros(3), rho])]
    network = eqx.tree_at(lambda n: (n.weights, n.biases), network, ([jnp.zeros((6, 1))], biases))
    np.testing.assert_allclose(network(jnp.zeros(1)).sigma, np.exp(rho), rtol=1e-5)
    gradient = jax.grad(lambda b: kl_to_prior(eqx.tree_at(lambda n: n.biases, network, [b])(jnp.zeros(1))))
    assert np.isfinite(gradient(biases[0])).all()
    assert (gradient(biases[0])[3:] < 0).all()  # the prior increases sigma
