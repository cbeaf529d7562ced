import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace.embed.gaussian import DiagonalGaussian, kl
from planspace.embed.networks import PlanSpaceModel
from planspace.embed.objectives import midpoint, variational

MODEL = PlanSpaceModel(4, 3, 0.1, key=jr.key(0))
TRIPLET = jr.normal(jr.key(1), (3, 4))


def test_midpoint_by_hand() -> None:
    a = DiagonalGaussian(jnp.array([0.0]), jnp.array([1.0]))
    b = DiagonalGaussian(jnp.array([4.0]), jnp.array([3.0]))
    # mean 2; variance (1 + 9) / 4, doubled to 5
    assert float(midpoint(a, b).mu[0]) == 2.0
    assert float(midpoint(a, b).sigma[0]) == pytest.approx(np.sqrt(5.0))
    same = midpoint(a, a)  # doubled, so that the midpoint of two equal ones is the same distribution
    assert float(kl(same, a)) == pytest.approx(0.0, abs=1e-7)


def test_the_bound_is_the_sum_of_its_terms() -> None:
    t = variational(MODEL, TRIPLET, 0.5, key=jr.key(2))
    assert float(t.bound) == pytest.approx(
        float(t.log_likelihood - t.prior_kl - 0.5 * t.midpoint_kl), rel=1e-5
    )
    assert float(t.prior_kl) > 0 and float(t.midpoint_kl) > 0


def test_linearity_weighs_the_midpoint_alone() -> None:
    low, high = (variational(MODEL, TRIPLET, w, key=jr.key(2)) for w in (0.5, 2.0))
    assert float(low.bound - high.bound) == pytest.approx(1.5 * float(low.midpoint_kl), rel=1e-4)


def test_a_batch_is_its_samples() -> None:
    triplets, keys = jr.normal(jr.key(3), (5, 3, 4)), jr.split(jr.key(4), 5)
    batched = jax.vmap(lambda x, k: variational(MODEL, x, 0.5, key=k).bound)(triplets, keys)
    single = [float(variational(MODEL, x, 0.5, key=k).bound) for x, k in zip(triplets, keys, strict=True)]
    np.testing.assert_allclose(batched, single, rtol=1e-5)


def test_deviations_are_elu_plus_one_above_the_floor() -> None:
    for x in jr.normal(jr.key(5), (20, 4)) * 10:
        assert (MODEL.encode(x).sigma > 0).all()
        assert (MODEL.decode(MODEL.encode(x).mu).sigma > 0.1).all()
