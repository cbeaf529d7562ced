from typing import Any

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.recording import recorded
from planspace.demos.state_info import StateInfo
from planspace.figures.distance import MAX_DRAWN, plot_distance_against_time
from tests.figures.examples import linear, random_demos, rendered


def test_straight_lines_with_the_same_speed_lie_on_the_diagonal() -> None:
    """z moves on a line at 2 per second for 1, 2 and 3 s: mean duration 2 s, mean distance 4, so y = x.

    The second state oscillates, so distances in state space are off the diagonal.
    """
    episodes = []
    for i, duration in enumerate((1.0, 2.0, 3.0)):
        times = np.linspace(0, duration, 11)
        states = np.column_stack([times, i + 5 * np.sin(20 * times)])
        episodes.append(recorded(states, np.zeros((10, 0)), times, i))
    demos = Demos.from_episodes(StateInfo(("p", "q"), ("m", "m"), (), 0), episodes)
    figure = rendered(plot_distance_against_time(linear(1, ("p", "q")), demos, np.arange(3)))
    plan: Any = figure.axes[0]
    raw: Any = figure.axes[1]
    curves = plan.collections[0].get_segments()
    assert len(curves) == len(raw.collections[0].get_segments()) == 3
    for curve, duration in zip(curves, (1.0, 2.0, 3.0), strict=True):
        np.testing.assert_allclose(curve[:, 0], np.linspace(duration / 2, 0, 11), atol=1e-9)
        np.testing.assert_allclose(curve[:, 1], curve[:, 0], atol=1e-9)
    off = [np.abs(c[:, 1] - c[:, 0]).max() for c in raw.collections[0].get_segments()]
    assert min(off) > 0.1
    for axes in (plan, raw):
        (diagonal,) = axes.lines
        np.testing.assert_allclose(diagonal.get_xdata(), [0, 1.5])  # the longest duration / the mean duration
        np.testing.assert_allclose(diagonal.get_ydata(), [0, 1.5])
    assert plan.get_xlabel() == "time left / mean duration (2 s)"
    np.testing.assert_allclose(plan.collections[0].get_array(), [1.0, 2.0, 3.0])


def test_the_state_is_standardised() -> None:
    """Doubling one number of the state does not change the figure."""
    demos = random_demos((5, 7))
    wide = Demos.from_episodes(
        demos.info,
        [
            recorded(e.states * [2.0, 1, 1, 1, 1], np.zeros((len(e.states) - 1, 0)), e.times, e.index)
            for e in (demos.episode(0), demos.episode(1))
        ],
    )
    first, second = (
        plot_distance_against_time(linear(2), d, np.arange(2)).axes[1].collections[0].get_segments()
        for d in (demos, wide)
    )
    np.testing.assert_allclose(np.concatenate(first), np.concatenate(second))


def test_means_include_demonstrations_that_are_not_drawn() -> None:
    demos = random_demos((3,) * MAX_DRAWN + (21,) * 5)
    axes = plot_distance_against_time(linear(2), demos, np.arange(len(demos))).axes[0]
    assert len(axes.collections[0].get_segments()) == MAX_DRAWN
    mean = (MAX_DRAWN * 0.2 + 5 * 2.0) / (MAX_DRAWN + 5)
    assert axes.get_xlabel().endswith(f"({mean:.3g} s)")
