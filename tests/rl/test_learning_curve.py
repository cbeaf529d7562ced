import numpy as np

from planspace.rl.learning_curve import SMOOTHING, learning_curve, smoothed


def test_smoothing_by_hand() -> None:
    returns = np.arange(12.0)[:, None]
    # the mean of all rows so far, at most the last ten
    expected = [np.mean(returns[max(0, i - SMOOTHING + 1) : i + 1]) for i in range(12)]
    np.testing.assert_allclose(smoothed(returns)[:, 0], expected)


def test_summary_over_seeds_by_hand() -> None:
    returns = np.tile([5.0, 1.0, 4.0, 2.0, 3.0], (4, 1))
    returns[2, 1] = 100.0  # the second seed reaches the highest value
    curve = learning_curve({"return": returns, "steps": np.arange(4)})
    assert (curve.mean[0], curve.low[0], curve.high[0]) == (3.0, 2.0, 4.0)
    np.testing.assert_allclose(curve.best, smoothed(returns)[:, 1])
