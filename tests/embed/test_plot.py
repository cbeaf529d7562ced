import html
import io
import json
import re
from typing import Any

import matplotlib.figure
import numpy as np
import pytest

from planspace.demos.dataset import Demos, StateInfo
from planspace.demos.recording import recorded
from planspace.embed.embedding import Embedding, Inputs
from planspace.errors import PlanspaceError
from planspace.figures.embedding import (
    MAX_DRAWN,
    MAX_INTERACTIVE,
    paths_html,
    plot_distance_against_time,
    plot_paths,
)

NAMES, UNITS = ("p", "q", "r", "s", "t"), ("m", "", "m/s", "rad/s", "N")


def linear(z_dim: int, names: tuple[str, ...] = NAMES) -> Embedding:
    """z is the first numbers of the state, the first of them doubled."""
    n = len(names)
    weight = np.concatenate([np.eye(z_dim, n), np.zeros((z_dim, n))])
    weight[0, 0] = 2.0
    inputs = Inputs(names, UNITS[:n], (), "raw", np.zeros(n), np.ones(n))
    return Embedding(
        inputs, ([weight], [np.zeros(2 * z_dim)]), ([np.zeros((2 * n, z_dim))], [np.zeros(2 * n)]), 0.2
    )


def made(lengths: tuple[int, ...], names: tuple[str, ...] = NAMES, problem: str = "") -> Demos:
    """Random walks, a step each 0.1 s."""
    rng = np.random.default_rng(0)
    episodes = [
        recorded(rng.normal(size=(n, len(names))).cumsum(axis=0), np.zeros((n - 1, 0)), np.arange(n) * 0.1, i)
        for i, n in enumerate(lengths)
    ]
    info = StateInfo(names, (*UNITS, "")[: len(names)], (), 0, problem=problem)
    return Demos.from_episodes(info, episodes)


def rendered(figure: matplotlib.figure.Figure) -> matplotlib.figure.Figure:
    """Drawn once, so that what matplotlib complains of fails here."""
    for kind in ("png", "svg"):
        figure.savefig(io.BytesIO(), format=kind, dpi=30)
    return figure


def segments(axes: Any) -> np.ndarray:
    (lines,) = axes.collections
    return np.array(lines._segments3d if hasattr(axes, "zaxis") else lines.get_segments())


def ends(axes: Any) -> np.ndarray:
    (mark,) = axes.lines
    return np.array(mark.get_data_3d() if hasattr(axes, "zaxis") else mark.get_data()).T


@pytest.mark.parametrize("z_dim", [1, 2, 3])
def test_paths_are_z_itself_coloured_by_the_time_left(z_dim: int) -> None:
    demos, embedding = made((4, 6, 5)), linear(z_dim)
    episodes = np.array([0, 2])
    axes: Any = rendered(plot_paths(embedding, demos, episodes)).axes[0]
    z = [embedding.encode(demos.episode(i).states) for i in (0, 2)]
    if z_dim == 1:
        z = [np.column_stack([demos.episode(i).times, p]) for i, p in zip((0, 2), z, strict=True)]
    expected = np.concatenate([np.stack([p[:-1], p[1:]], axis=1) for p in z])
    np.testing.assert_allclose(segments(axes), expected, atol=1e-12)
    np.testing.assert_allclose(ends(axes), [p[-1] for p in z])
    left = axes.collections[0].get_array()
    np.testing.assert_allclose(left, [0.3, 0.2, 0.1, 0.4, 0.3, 0.2, 0.1], atol=1e-12)
    labels = [axes.get_xlabel(), axes.get_ylabel()] + ([axes.get_zlabel()] if z_dim == 3 else [])
    assert labels == {1: ["time [s]", "z"], 2: ["z1", "z2"], 3: ["z1", "z2", "z3"]}[z_dim]


def test_above_three_the_principal_components_are_drawn() -> None:
    """Along the axes of z lie variances 16, 9, 4, 1 and 0: shares 53, 30 and 13 %."""
    z = np.concatenate([np.diag([4.0, 3.0, 2.0, 1.0, 0.0]), -np.diag([4.0, 3.0, 2.0, 1.0, 0.0])])
    states = z / [2.0, 1.0, 1.0, 1.0, 1.0]
    info = StateInfo(NAMES, UNITS, (), 0)
    demos = Demos.from_episodes(info, [recorded(states, np.zeros((9, 0)), np.arange(10) * 0.1, 0)])
    axes: Any = rendered(plot_paths(linear(5), demos, np.array([0]))).axes[0]
    labels = [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()]
    assert labels == ["z component 1 (53 %)", "z component 2 (30 %)", "z component 3 (13 %)"]
    np.testing.assert_allclose(np.abs(segments(axes)[:, 0]), np.abs(z[:-1, :3]), atol=1e-12)


@pytest.mark.parametrize("z_dim", [2, 3])
def test_a_length_in_z_is_as_long_in_every_direction(z_dim: int) -> None:
    axes: Any = rendered(plot_paths(linear(z_dim), made((30,)), np.array([0]))).axes[0]
    if z_dim == 2:
        assert axes.get_aspect() == 1.0
    else:
        limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
        scale = np.diff(limits)[:, 0] / axes._box_aspect
        np.testing.assert_allclose(scale, scale[0])


def test_only_the_first_are_drawn_and_the_title_says_so() -> None:
    demos = made((3,) * (MAX_DRAWN + 5), problem="acrobot")
    figure = plot_paths(linear(2), demos, np.arange(len(demos)))
    assert len(segments(figure.axes[0])) == 2 * MAX_DRAWN
    title = f"The first {MAX_DRAWN} of {MAX_DRAWN + 5} demonstrations of acrobot in plan space, z of 2"
    assert figure.get_suptitle() == title
    assert plot_paths(linear(2), demos, np.array([7])).get_suptitle().startswith("A demonstration of acrobot")


def test_states_the_embedding_does_not_read_are_passed_over() -> None:
    names = ("q", "unread", "p")
    demos, embedding = made((5, 5), names), linear(2, ("p", "q"))
    axes = plot_paths(embedding, demos, np.array([1])).axes[0]
    np.testing.assert_allclose(ends(axes), demos.states[-1:, [2, 0]] * [2.0, 1.0])
    assert "unread" not in new_plot(paths_html(embedding, demos, np.array([1])))[0][0]["hovertemplate"]
    for draw in (plot_paths, paths_html, plot_distance_against_time):
        with pytest.raises(PlanspaceError, match="'q' is missing"):
            draw(embedding, made((5,), ("p", "other")), np.array([0]))


def new_plot(page: str) -> tuple[list[dict[str, Any]], dict[str, Any], dict[str, Any]]:
    """The traces, layout and configuration that the page hands to Plotly."""
    text, decoder = page[page.rindex("Plotly.newPlot(") :], json.JSONDecoder()
    parts = []
    at = text.index(",") + 1
    for _ in range(3):
        at += len(text[at:]) - len(text[at:].lstrip(" \n,"))
        value, length = decoder.raw_decode(text[at:])
        parts.append(value)
        at += length
    return tuple(parts)


@pytest.mark.parametrize("z_dim", [1, 2, 3, 5])
def test_the_page_holds_each_state_with_its_name_and_unit(z_dim: int) -> None:
    demos = made((4, 6, 5))
    (lines, marks), _, config = new_plot(paths_html(linear(z_dim), demos, np.array([0, 2])))
    rows = lines["customdata"]
    assert rows[4] == rows[10] == [None] * 8  # a gap after each, so that no line joins two demonstrations
    assert lines["x"][4] is None and lines["y"][10] is None
    episode = demos.episode(2)
    expected = np.column_stack(
        [np.full(5, 2), episode.times, episode.times[-1] - episode.times, episode.states]
    )
    np.testing.assert_allclose(rows[5:10], expected, atol=1e-4)
    np.testing.assert_allclose(lines["marker"]["color"][5:10], [0.4, 0.3, 0.2, 0.1, 0.0], atol=1e-4)
    hover = lines["hovertemplate"]
    assert "demonstration %{customdata[0]}<br>%{customdata[1]:.2f} s, %{customdata[2]:.2f} s left" in hover
    assert "<br>p %{customdata[3]:.3f} m<br>q %{customdata[4]:.3f} <br>r %{customdata[5]:.3f} m/s" in hover
    assert marks["x"] == [lines["x"][3], lines["x"][9]] and marks["name"] == "end of a demonstration"
    assert marks["type"] == ("scatter3d" if z_dim >= 3 else "scatter")
    if z_dim == 2:
        np.testing.assert_allclose(lines["x"][:4], 2 * demos.episode(0).states[:, 0], atol=1e-4)
    assert config["showSendToCloud"] is False


def test_the_page_needs_nothing_beside_it_and_loads_nothing() -> None:
    page = paths_html(linear(3), made((4, 4)), np.arange(2))
    assert page.count("newPlot(") >= 1 and len(page) > 1_000_000  # Plotly's script is in it
    rest = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"https?://|\bsrc=|\bhref=|@import|url\(", rest)
    assert not re.search(r"<script[^>]*\bsrc=", page)
    assert "default-src 'none'" in " ".join(page.split())


def test_names_cannot_break_the_page() -> None:
    names = ("</script><b>x</b>", "%{customdata[1]}")
    page = paths_html(linear(2, names), made((4,), names, problem="<i>&"), np.array([0]))
    (lines, _), _, _ = new_plot(page)
    shown = html.unescape(lines["hovertemplate"].replace("<br>", "\n").replace("<extra></extra>", ""))
    assert shown.splitlines()[2:] == [
        "</script><b>x</b> %{customdata[3]:.3f} m",
        "%{customdata[1]} %{customdata[4]:.3f} ",
    ]
    assert "%{customdata[1]} %" not in lines["hovertemplate"]  # else Plotly would fill it in
    assert "<title>A demonstration of &lt;i&gt;&amp; in plan space, z of 2</title>" in page


def test_the_page_holds_so_many_and_no_more() -> None:
    demos = made((3,) * (MAX_INTERACTIVE + 3))
    (lines, marks), _, _ = new_plot(paths_html(linear(2), demos, np.arange(len(demos))))
    assert len(marks["x"]) == MAX_INTERACTIVE
    assert {row[0] for row in lines["customdata"]} - {None} == set(range(MAX_INTERACTIVE))


def test_straight_lines_at_one_speed_lie_on_the_diagonal() -> None:
    """z runs along a line at 2 / s for 1, 2 and 3 s: mean duration 2 s, mean distance 4, so y = x.

    The state oscillates beside it, so that its own distances do not.
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
        np.testing.assert_allclose(diagonal.get_xdata(), [0, 1.5])  # the longest, over the mean
        np.testing.assert_allclose(diagonal.get_ydata(), [0, 1.5])
    assert plan.get_xlabel() == "time left, over the mean duration of 2 s"
    np.testing.assert_allclose(plan.collections[0].get_array(), [1.0, 2.0, 3.0])


def test_the_raw_state_is_standardised() -> None:
    """Doubling a number of the state changes nothing."""
    demos = made((5, 7))
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


def test_all_are_averaged_though_the_first_alone_are_drawn() -> None:
    demos = made((3,) * MAX_DRAWN + (21,) * 5)
    axes = plot_distance_against_time(linear(2), demos, np.arange(len(demos))).axes[0]
    assert len(axes.collections[0].get_segments()) == MAX_DRAWN
    mean = (MAX_DRAWN * 0.2 + 5 * 2.0) / (MAX_DRAWN + 5)
    assert axes.get_xlabel().endswith(f"of {mean:.3g} s")


def test_a_z_that_knows_nothing_is_drawn_as_zero() -> None:
    embedding = linear(3)
    embedding.encoder[0][0][:] = 0.0
    demos = made((4, 5))
    curves = plot_distance_against_time(embedding, demos, np.arange(2)).axes[0].collections[0].get_segments()
    assert all((c[:, 1] == 0).all() for c in curves)
    rendered(plot_paths(embedding, demos, np.arange(2)))


def test_a_trained_embedding_is_drawn(embedding: Embedding, demos: Demos) -> None:
    episodes = np.array(embedding.about["split"]["train"])
    assert len(segments(rendered(plot_paths(embedding, demos, episodes)).axes[0])) == sum(
        len(demos.episode(int(i)).states) - 1 for i in episodes
    )
    rendered(plot_distance_against_time(embedding, demos, episodes))
    hover = new_plot(paths_html(embedding, demos, episodes))[0][0]["hovertemplate"]
    assert all(f"<br>{name} %" in hover for name in ("slider", "hinge", "slidervel", "hingevel"))
