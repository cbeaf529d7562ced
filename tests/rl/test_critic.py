import numpy as np

from planspace.rl import critic


def test_features_by_hand() -> None:
    x = critic.features(np.array([[2.0, -30.0]], dtype=np.float32), np.array([50]))
    np.testing.assert_allclose(x, [[2, -10, 4, 100, 0.5, 0.25, 0.125, 1]])


def test_fit_finds_each_seeds_own_function(rng: np.random.Generator) -> None:
    obs, step = rng.normal(size=(2, 500, 3)), rng.integers(0, 200, (2, 500))
    x = critic.features(obs, step)
    truth = rng.normal(size=(2, x.shape[-1]))
    weights = critic.ridge_regression(x, np.einsum("sbf,sf->sb", x, truth))
    np.testing.assert_allclose(weights, truth, atol=1e-4)


def test_redundant_features_do_not_break_it(rng: np.random.Generator) -> None:
    angle = rng.uniform(-3, 3, (1, 500))
    obs = np.stack([angle, np.sin(angle), np.cos(angle)], axis=-1)  # sin^2 + cos^2 = 1, the constant
    x = critic.features(obs, np.zeros((1, 500), int))
    returns = 3 * np.sin(angle) + 1
    weights = critic.ridge_regression(x, returns)
    np.testing.assert_allclose(np.einsum("sbf,sf->sb", x, weights), returns, atol=1e-3)
