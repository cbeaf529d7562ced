import io
from dataclasses import replace
from typing import Any

import numpy as np

from planspace.demos.state_info import StateInfo
from planspace.figures import demos as demo_figure
from planspace.figures.demos import plot_demos
from planspace.figures.distance import plot_distance_against_time
from planspace.figures.interactive_paths import MAX_INTERACTIVE, interactive_points, paths_html
from planspace.figures.paths import MAX_POINTS, embedded_paths
from planspace.figures.plot_paths import plot_paths
from planspace.figures.thinning import thin, thin_paths
from tests.figures.examples import linear, random_demos

LONG = (40_000, 20_000)


def svg_of(figure: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=150)
    return buffer.getvalue()


def test_thinning_keeps_the_ends_and_the_extremes_of_each_axis() -> None:
    path = np.column_stack([np.arange(1000.0), np.zeros(1000)])
    path[417, 1], path[733, 1] = 5.0, -5.0  # spikes of one state
    rows = thin(path, 50)
    assert len(rows) <= 50 and (np.diff(rows) > 0).all()
    assert {0, 417, 733, 999} <= set(rows)
    np.testing.assert_array_equal(thin(path, 1000), np.arange(1000))  # short enough: nothing is left out


def test_each_path_keeps_the_same_fraction() -> None:
    paths = [np.random.default_rng(n).normal(size=(n, 1)) for n in (8000, 2000)]
    first, second = map(len, thin_paths(paths, 1000))
    assert 700 < first <= 800 and 150 < second <= 200
    assert [len(rows) for rows in thin_paths(paths, 10_000)] == [8000, 2000]


def test_states_of_long_recordings_are_one_small_layer_of_pixels() -> None:
    """Without thinning and pixels, this file would have about 160 bytes for each of 300,000 points."""
    demos = random_demos(LONG)
    figure = plot_demos(demos)
    panels: list[Any] = figure.axes[:-1]
    for axes in panels:
        (points,) = axes.collections
        assert len(points.get_offsets()) <= demo_figure.MAX_POINTS and points.get_rasterized()
    assert figure.get_suptitle() == "About 20,000 of 60,000 states in each panel"
    assert len(svg_of(figure)) < 4e6
    y = demos.states[:, 0]
    drawn = panels[0].collections[0].get_offsets()[:, 1]
    assert (drawn.min(), drawn.max()) == (y.min(), y.max())


def test_short_demonstrations_are_drawn_whole_and_as_lines() -> None:
    demos = random_demos((40, 60))
    figure = plot_demos(demos)
    axes: Any = figure.axes[0]
    (points,) = axes.collections
    np.testing.assert_array_equal(points.get_offsets()[:, 1], demos.states[:, 0])
    assert not points.get_rasterized() and figure.get_suptitle() == ""


def test_many_columns_and_demonstrations_are_limited_and_the_title_says_so() -> None:
    names = tuple(f"c{k}" for k in range(demo_figure.MAX_PANELS + 3))
    demos = random_demos((4,) * (demo_figure.MAX_DRAWN + 1), ("c0",))
    wide = replace(
        demos,
        info=StateInfo(names, ("",) * len(names), (), 0),
        states=np.tile(demos.states, (1, len(names))),
        goals=np.tile(demos.goals, (1, len(names))),
    )
    figure = plot_demos(wide)
    assert len(figure.axes) == demo_figure.MAX_PANELS + 1
    assert figure.get_suptitle() == "The first 100 of 101 demonstrations, the first 60 of 63 panels"


def test_long_paths_in_z_are_small_in_every_figure() -> None:
    demos, embedding, both = random_demos(LONG), linear(3), np.arange(2)
    paths = embedded_paths(embedding, demos, both)
    assert sum(map(len, paths.points)) <= MAX_POINTS
    assert paths.title.endswith("of 60,000 states drawn")
    for points, states, times in zip(paths.points, paths.states, paths.times, strict=True):
        np.testing.assert_array_equal(points, embedding.encode(states))  # a point has its own state
        np.testing.assert_array_equal(np.round(times / 0.1) % 1, 0)
    figure = plot_paths(paths)
    assert figure.axes[0].collections[0].get_rasterized() and len(svg_of(figure)) < 1e6
    most = interactive_points(embedding.state_dim)
    page = paths_html(embedded_paths(embedding, demos, both, MAX_INTERACTIVE, most))
    assert len(page) < 11e6  # of which Plotly's script is 4.6 MB
    assert len(svg_of(plot_distance_against_time(embedding, demos, both))) < 1e6
