import jax.random as jr
import numpy as np

from planspace.rl import critic
from planspace.rl.normalise import ObsStatistics


def test_features_by_hand() -> None:
    x = critic.features(np.array([[2.0, -30.0]], dtype=np.float32), np.array([50]))
    np.testing.assert_allclose(x, [[2, -10, 4, 100, 0.5, 0.25, 0.125, 1]])


def test_the_fit_recovers_a_linear_function(rng: np.random.Generator) -> None:
    obs, step = rng.normal(size=(500, 3)), rng.integers(0, 200, 500)
    x = critic.features(obs, step)
    truth = rng.normal(size=x.shape[-1])
    weights = critic.ridge_regression(x, x @ truth)
    np.testing.assert_allclose(weights, truth, atol=1e-4)


def test_redundant_features_do_not_break_the_fit(rng: np.random.Generator) -> None:
    angle = rng.uniform(-3, 3, 500)
    obs = np.stack([angle, np.sin(angle), np.cos(angle)], axis=-1)  # sin^2 + cos^2 is the constant feature
    x = critic.features(obs, np.zeros(500, int))
    returns = 3 * np.sin(angle) + 1
    weights = critic.ridge_regression(x, returns)
    np.testing.assert_allclose(x @ weights, returns, atol=1e-3)


def test_the_network_critic_fits_returns_of_any_scale(rng: np.random.Generator) -> None:
    fresh = critic.make_critic("mlp", 3, (32, 32), key=jr.key(0))
    obs = rng.normal(50.0, 0.01, (2000, 3)).astype(np.float32)
    step = np.zeros(2000, int)
    np.testing.assert_array_equal(fresh.values(obs, step), 0.0)  # before the first fit
    returns = 1000 + 3000 * (obs[:, 0] - 50).astype(float)
    fitted = fresh
    for _ in range(5):
        fitted = fitted.fitted(obs, step, returns, key=jr.key(1))
    error = fitted.values(obs, step) - returns
    assert np.abs(error).mean() < 0.1 * returns.std()


def test_statistics_of_parts_equal_those_of_all_observations(rng: np.random.Generator) -> None:
    obs = rng.normal([3.0, -1.0], [0.1, 20.0], (2, 300, 2))
    empty = ObsStatistics.stacked([ObsStatistics.empty(2)] * 2)
    parts, whole = empty, empty.with_more(obs)
    assert parts(obs) is obs  # without statistics, observations are not changed
    for part in np.split(obs, [10, 150], axis=1):
        parts = parts.with_more(part)
    np.testing.assert_allclose(parts.mean, obs.mean(axis=1), rtol=1e-9)
    np.testing.assert_allclose(parts.squares, whole.squares, rtol=1e-9)
    np.testing.assert_allclose(parts(obs).std(axis=1), 1.0, rtol=1e-3)
    assert np.abs(parts(obs + 1e6)).max() == 10.0


def test_a_number_that_does_not_vary_in_plans_is_only_shifted(rng: np.random.Generator) -> None:
    tiny, rounded = rng.normal(1.0, 1e-5, (300, 1)), np.float32(300.1) + rng.normal(0, 3e-5, (300, 1))
    obs = np.hstack([rng.normal(3.0, 2.0, (300, 1)), np.full((300, 1), 0.7), tiny, rounded])
    found = ObsStatistics.of(obs)
    np.testing.assert_allclose(found.std, [obs[:, 0].std(), 1.0, 1.0, 1.0], rtol=1e-6)
    np.testing.assert_allclose(found(np.array([[3.0, 1.2, 1.5, 300.6]]))[0, 1:], 0.5, atol=1e-4)
