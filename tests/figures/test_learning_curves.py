import numpy as np

from planspace.figures.learning_curves import plot_curves
from planspace.rl.learning_curve import SMOOTHING, learning_curve


def test_the_figure_shows_the_mean_and_the_best_seed() -> None:
    returns = np.random.default_rng(0).normal(size=(5, 6))
    curve = learning_curve({"return": returns, "steps": 4000 * np.arange(1, 6)})
    axes = plot_curves({"raw": curve}, "cartpole").axes[0]
    mean, best = axes.lines
    np.testing.assert_allclose(mean.get_ydata(), curve.mean)
    np.testing.assert_allclose(best.get_ydata(), curve.best)
    assert best.get_linestyle() == "--" and f"mean over {SMOOTHING} iterations" in axes.get_ylabel()
