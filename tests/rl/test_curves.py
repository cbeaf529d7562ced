import numpy as np

from planspace.figures.learning_curves import SMOOTHING, learning_curve, plot_curves, smoothed


def test_smoothing_by_hand() -> None:
    returns = np.arange(12.0)[:, None]
    # at first the mean of what there is, then of the last ten
    expected = [np.mean(returns[max(0, i - SMOOTHING + 1) : i + 1]) for i in range(12)]
    np.testing.assert_allclose(smoothed(returns)[:, 0], expected)


def test_the_curve_is_the_papers() -> None:
    returns = np.tile([5.0, 1.0, 4.0, 2.0, 3.0], (4, 1))
    returns[2, 1] = 100.0  # the second seed reaches the highest value, at one step
    curve = learning_curve({"return": returns, "steps": np.arange(4)})
    assert (curve.mean[0], curve.low[0], curve.high[0]) == (3.0, 2.0, 4.0)
    np.testing.assert_allclose(curve.best, smoothed(returns)[:, 1])


def test_the_figure_draws_what_the_curve_says() -> None:
    returns = np.random.default_rng(0).normal(size=(5, 6))
    curve = learning_curve({"return": returns, "steps": 4000 * np.arange(1, 6)})
    axes = plot_curves({"raw": curve}, "cartpole").axes[0]
    mean, best = axes.lines
    np.testing.assert_allclose(mean.get_ydata(), curve.mean)
    np.testing.assert_allclose(best.get_ydata(), curve.best)
    assert best.get_linestyle() == "--" and f"mean of {SMOOTHING} iterations" in axes.get_ylabel()
