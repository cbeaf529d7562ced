import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace.embed.gaussian import DiagonalGaussian, kl
from planspace.embed.losses import Terms, balanced_kl, between
from planspace.embed.networks import PlanSpaceModel
from planspace.embed.objective import Objective
from planspace.embed.objectives import OBJECTIVES
from planspace.embed.objectives.direct import Direct
from planspace.embed.objectives.distance import Distance
from planspace.embed.objectives.vae import AutoEncoder
from planspace.embed.objectives.variational import Variational
from planspace.embed.samples import Sample
from planspace.embed.steps import sample_terms

MODEL = PlanSpaceModel(4, 3, (64, 64), 0.1, num_controls=2, key=jr.key(0))
PAPER = Variational(linearity=0.5, prior=1.0, off_data_weight=0.0)
TRAINED = [
    name if name == "variational" else pytest.param(name, marks=pytest.mark.slow)
    for name in OBJECTIVES
    if name != "pca"
]
HALF = jnp.array(0.5)


def sample(key: int = 1, w: float = 0.5) -> Sample:
    return Sample(
        jr.normal(jr.key(key), (3, 4)),
        jnp.array(w),
        jnp.array(0.4),
        jr.normal(jr.key(key + 99), (4,)),
        jnp.array([0.3, -0.2]),
    )


def terms(objective: Objective, model: PlanSpaceModel, s: Sample, key: jax.Array) -> Terms:
    return sample_terms(objective, model, s, key=key)


def identity(num: int) -> PlanSpaceModel:
    """A linear model whose means are the inputs; the standard deviations of z and of decoded states are 1."""
    model = PlanSpaceModel(num, num, (), 0.0, key=jr.key(0))
    eye = jnp.concatenate([jnp.eye(num), jnp.zeros((num, num))])
    return eqx.tree_at(lambda m: (m.encode.weights[0], m.decode.weights[0]), model, (eye, eye))


def test_midpoint_by_hand() -> None:
    a = DiagonalGaussian(jnp.array([0.0]), jnp.array([1.0]))
    b = DiagonalGaussian(jnp.array([4.0]), jnp.array([3.0]))
    # mean 2; variance (1 + 9) / 4, doubled to 5
    doubled, plain = (between(a, b, HALF, double_variance=d) for d in (True, False))
    assert float(doubled.mu[0]) == 2.0
    assert float(doubled.sigma[0]) == pytest.approx(math.sqrt(5.0))
    assert float(plain.sigma[0]) == pytest.approx(math.sqrt(2.5))
    same = between(
        a, a, HALF, double_variance=True
    )  # the midpoint of two equal distributions is the same one
    assert float(kl(same, a)) == pytest.approx(0.0, abs=1e-7)


def test_a_point_at_a_quarter_by_hand() -> None:
    a = DiagonalGaussian(jnp.array([0.0]), jnp.array([1.0]))
    b = DiagonalGaussian(jnp.array([4.0]), jnp.array([3.0]))
    q = between(a, b, jnp.array(0.25), double_variance=True)
    # mean 0.75 * 0 + 0.25 * 4 = 1; variance 0.75 * 1 + 0.25 * 9 = 3
    assert (float(q.mu[0]), float(q.sigma[0])) == (1.0, pytest.approx(math.sqrt(3.0)))


def test_the_bound_is_the_sum_of_its_terms() -> None:
    t = terms(PAPER, MODEL, sample(), jr.key(2))
    assert float(t["bound"]) == pytest.approx(
        float(t["log_likelihood"] - t["prior_kl"] - 0.5 * t["midpoint_kl"]), rel=1e-5
    )
    assert float(t["prior_kl"]) > 0 and float(t["midpoint_kl"]) > 0


@pytest.mark.parametrize("weight", ["curvature", "distance"])
def test_curvature_and_distance_reduce_the_bound(weight: str) -> None:
    with_term = replace(PAPER, **{weight: 2.0})
    plain, more = (terms(c, MODEL, sample(), jr.key(2)) for c in (PAPER, with_term))
    term = more[{"distance": "distance_error"}.get(weight, weight)]
    assert float(plain["bound"] - more["bound"]) == pytest.approx(2 * float(term), rel=1e-4)
    assert float(term) > 0


def test_terms_of_a_straight_line_by_hand() -> None:
    model = identity(2)
    x = jnp.array([[0.0, 0.0], [0.75, 1.0], [3.0, 4.0]])  # t a quarter of the way along a line of length 5
    line = Sample(x, jnp.array(0.25), jnp.array(5.0), x[0], jnp.zeros(0))
    config = replace(PAPER, curvature=1.0, distance=1.0)
    t = terms(config, model, line, jr.key(0))
    assert float(t["midpoint_kl"]) == pytest.approx(0.0, abs=1e-6)
    assert float(t["curvature"]) == pytest.approx(0.0, abs=1e-5)
    assert float(t["distance_error"]) == pytest.approx(0.0, abs=1e-4)  # |z_b - z_a| = 5 durations
    bent = eqx.tree_at(lambda s: s.x, line, jnp.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]]))
    # a right angle: 1 - cos = 1; from (0.75, 1) to (3, 0), with standard deviation 1: KL = (2.25^2 + 1) / 2
    t = terms(config, model, bent, jr.key(0))
    assert float(t["curvature"]) == pytest.approx(1.0, abs=1e-5)
    assert float(t["midpoint_kl"]) == pytest.approx((2.25**2 + 1) / 2, rel=1e-5)


def test_the_term_of_states_off_the_demonstrations_by_hand() -> None:
    model, x = identity(2), jnp.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])
    s = Sample(x, HALF, jnp.array(1.0), jnp.array([3.0, 4.0]), jnp.zeros(0))
    low, high = (terms(replace(PAPER, off_data_weight=w), model, s, jr.key(0)) for w in (1.0, 3.0))
    noise = jr.normal(jr.split(jr.key(0), 4)[3], (2,))
    # z = x + noise is decoded as itself: log N = -|noise|^2 / 2 - log 2 pi; KL to N(0, 1) = |x|^2 / 2 = 12.5
    expected = -float(jnp.sum(noise**2)) / 2 - math.log(2 * math.pi) - 12.5
    assert float(low["off_data"]) == pytest.approx(expected, rel=1e-4)
    assert float(high["bound"] - low["bound"]) == pytest.approx(2 * expected, rel=1e-4)


@pytest.mark.parametrize(("name", "term"), [("straightening", "curvature"), ("e2c", "dynamics_kl")])
def test_straightening_and_e2c_apply_their_weights(name, term: str) -> None:
    def bound(**weights: float) -> dict:
        objective: Any = OBJECTIVES[name]
        return terms(replace(objective, **weights), MODEL, sample(), jr.key(0))

    plain, linear, weak_prior = bound(linearity=1.0), bound(linearity=3.0), bound(linearity=1.0, prior=0.5)
    assert float(plain["bound"] - linear["bound"]) == pytest.approx(2 * float(plain[term]), rel=1e-3)
    assert float(plain["bound"] - weak_prior["bound"]) == pytest.approx(
        0.4 * float(plain["prior_kl"]), rel=1e-3
    )
    assert float(plain[term]) > 0


def test_a_vae_by_hand() -> None:
    x = jnp.array([[3.0, 4.0], [0.0, 0.0], [0.0, 0.0]])
    s = Sample(x, HALF, jnp.array(1.0), x[0], jnp.zeros(0))
    t = terms(AutoEncoder(prior=1.0), identity(2), s, jr.key(0))
    assert float(t["prior_kl"]) == pytest.approx(12.5)  # |x|^2 / 2 for the first state, 0 for the others
    assert float(t["bound"]) == pytest.approx(float(t["log_likelihood"]) - 12.5, rel=1e-5)


def test_balance_changes_the_gradient_but_not_the_value() -> None:
    one = jnp.ones(1)

    def gradient(balance: float) -> tuple[float, float, float]:
        def f(p: jax.Array, q: jax.Array) -> jax.Array:
            return balanced_kl(DiagonalGaussian(p, one), DiagonalGaussian(q, one), balance)

        p, q = jnp.array([1.0]), jnp.array([3.0])
        at_p, at_q = jax.grad(f, (0, 1))(p, q)
        return float(f(p, q)), float(at_p[0]), float(at_q[0])

    # KL = (p - q)^2 / 2 = 2, its gradients -2 and 2; balance 0.8: 0.4 times the first, 1.6 times the second
    assert gradient(0.5) == pytest.approx((2.0, -2.0, 2.0))
    assert gradient(0.8) == pytest.approx((2.0, -0.8, 3.2))


@pytest.mark.parametrize(("metric", "expected"), [("l2", 5.0), ("squared", 25.0), ("l1", 7.0)])
def test_the_direct_loss_is_the_distance_to_the_decoded_midpoint(metric, expected: float) -> None:
    x = jnp.array([[0.0, 0.0], [4.0, 5.0], [2.0, 2.0]])  # the midpoint is (1, 1), (3, 4) away from x_t
    s = Sample(x, HALF, jnp.array(1.0), x[0], jnp.zeros(0))
    t = terms(Direct(metric=metric), identity(2), s, jr.key(0))
    assert float(t["bound"]) == pytest.approx(-expected, rel=1e-5)


def test_the_distance_error_by_hand() -> None:
    x = jnp.array([[0.0, 0.0], [1.0, 1.0], [3.0, 4.0]])
    s = Sample(x, HALF, jnp.array(3.0), x[0], jnp.zeros(0))
    t = terms(Distance(), identity(2), s, jr.key(0))
    assert float(t["distance_error"]) == pytest.approx((5 - 3) ** 2, rel=1e-4)


def test_e2c_dynamics_of_a_known_linear_system() -> None:
    model = eqx.tree_at(
        lambda m: m.transition.biases[-1],
        PlanSpaceModel(2, 2, (), 0.0, num_controls=1, key=jr.key(0)),
        # v = (1, 0), r = (0, 0.5), offset = (0, 1), B = (2, 0): z' = z + v (r . z) + o + B u
        jnp.array([1.0, 0.0, 0.0, 0.5, 0.0, 1.0, 2.0, 0.0]),
    )
    model = eqx.tree_at(lambda m: m.transition.weights[0], model, jnp.zeros((8, 2)))
    q = DiagonalGaussian(jnp.array([1.0, 4.0]), jnp.array([1.0, 2.0]))
    assert model.transition is not None
    after = model.transition(q.mu, q, jnp.array([3.0]))
    np.testing.assert_allclose(after.mu, [1 + 0.5 * 4 + 2 * 3, 4 + 1])
    np.testing.assert_allclose(after.sigma, [math.sqrt(1 + 0.25 * 4), 2.0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["random", "distance"])
def test_fitting_only_the_decoder_gives_the_encoder_no_gradient(name) -> None:
    def loss(model: PlanSpaceModel) -> jax.Array:
        s = sample()
        exact = jnp.linalg.norm(model.encode(s.x[2]).mu - model.encode(s.x[0]).mu)
        s = eqx.tree_at(
            lambda s: s.duration, s, jax.lax.stop_gradient(exact)
        )  # so that the distance error is 0
        return terms(OBJECTIVES[name], model, s, jr.key(0))["bound"]

    gradient = eqx.filter_grad(loss)(MODEL)
    assert max(float(jnp.abs(w).max()) for w in gradient.encode.weights) < 1e-4
    assert float(jnp.abs(gradient.decode.weights[0]).max()) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", TRAINED)
def test_a_batch_equals_its_samples_and_gradients_are_finite(name) -> None:
    objective, keys = OBJECTIVES[name], jr.split(jr.key(4), 5)
    samples = [sample(i) for i in range(5)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *samples)
    batched = jax.vmap(lambda s, k: terms(objective, MODEL, s, k)["bound"])(batch, keys)
    single = [float(terms(objective, MODEL, s, k)["bound"]) for s, k in zip(samples, keys, strict=True)]
    np.testing.assert_allclose(batched, single, rtol=1e-4)
    gradient = eqx.filter_grad(lambda m: terms(objective, m, samples[0], keys[0])["bound"])(MODEL)
    assert all(bool(jnp.isfinite(g).all()) for g in jax.tree.leaves(gradient))
    assert float(jnp.abs(gradient.decode.weights[-1]).max()) > 0


@pytest.mark.slow
def test_equal_states_have_finite_gradients() -> None:
    """A norm has no gradient at zero."""
    s = eqx.tree_at(lambda s: s.x, sample(), jnp.zeros((3, 4)))
    config = replace(PAPER, curvature=1.0, distance=1.0)
    gradient = eqx.filter_grad(lambda m: terms(config, m, s, jr.key(0))["bound"])(MODEL)
    assert all(bool(jnp.isfinite(g).all()) for g in jax.tree.leaves(gradient))


def test_standard_deviations_are_above_the_floor() -> None:
    for x in jr.normal(jr.key(5), (20, 4)) * 10:
        assert (MODEL.encode(x).sigma > 0).all()
        assert (MODEL.decode(MODEL.encode(x).mu).sigma > 0.1).all()
