import html
import json
import re
from typing import Any

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.recording import recorded
from planspace.demos.state_info import StateInfo
from planspace.embed.embedding import Embedding
from planspace.errors import PlanspaceError
from planspace.figures.distance import plot_distance_against_time
from planspace.figures.interactive_paths import MAX_INTERACTIVE, paths_html
from planspace.figures.paths import MAX_DRAWN, embedded_paths
from planspace.figures.plot_paths import plot_paths
from tests.figures.examples import NAMES, UNITS, linear, random_demos, rendered


def segments(axes: Any) -> np.ndarray:
    (lines,) = axes.collections
    return np.array(lines._segments3d if hasattr(axes, "zaxis") else lines.get_segments())


def ends(axes: Any) -> np.ndarray:
    (mark,) = axes.lines
    return np.array(mark.get_data_3d() if hasattr(axes, "zaxis") else mark.get_data()).T


@pytest.mark.parametrize("z_dim", [1, 2, 3])
def test_paths_show_z_coloured_by_time_left(z_dim: int) -> None:
    demos, embedding = random_demos((4, 6, 5)), linear(z_dim)
    episodes = np.array([0, 2])
    axes: Any = rendered(plot_paths(embedded_paths(embedding, demos, episodes))).axes[0]
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


def test_more_than_three_dimensions_are_drawn_as_principal_components() -> None:
    """The axes of z have variances proportional to 16, 9, 4, 1 and 0: fractions of 53, 30 and 13 %."""
    z = np.concatenate([np.diag([4.0, 3.0, 2.0, 1.0, 0.0]), -np.diag([4.0, 3.0, 2.0, 1.0, 0.0])])
    states = z / [2.0, 1.0, 1.0, 1.0, 1.0]
    info = StateInfo(NAMES, UNITS, (), 0)
    demos = Demos.from_episodes(info, [recorded(states, np.zeros((9, 0)), np.arange(10) * 0.1, 0)])
    axes: Any = rendered(plot_paths(embedded_paths(linear(5), demos, np.array([0])))).axes[0]
    labels = [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()]
    assert labels == ["z component 1 (53 %)", "z component 2 (30 %)", "z component 3 (13 %)"]
    np.testing.assert_allclose(np.abs(segments(axes)[:, 0]), np.abs(z[:-1, :3]), atol=1e-12)


@pytest.mark.parametrize("z_dim", [2, 3])
def test_distances_in_z_have_the_same_scale_on_every_axis(z_dim: int) -> None:
    paths = embedded_paths(linear(z_dim), random_demos((30,)), np.array([0]))
    axes: Any = rendered(plot_paths(paths)).axes[0]
    if z_dim == 2:
        assert axes.get_aspect() == 1.0
    else:
        limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
        scale = np.diff(limits)[:, 0] / axes._box_aspect
        np.testing.assert_allclose(scale, scale[0])


def test_only_the_first_demonstrations_are_drawn_and_the_title_says_so() -> None:
    demos = random_demos((3,) * (MAX_DRAWN + 5), problem="acrobot")
    figure = plot_paths(embedded_paths(linear(2), demos, np.arange(len(demos))))
    assert len(segments(figure.axes[0])) == 2 * MAX_DRAWN
    which = f"The first {MAX_DRAWN} of {MAX_DRAWN + 5} demonstrations"
    title = f"{which} of acrobot in plan space (z has 2 dimensions)"
    assert figure.get_suptitle() == title
    one = embedded_paths(linear(2), demos, np.array([7]))
    assert one.title == "A demonstration of acrobot in plan space (z has 2 dimensions)"


def test_states_that_the_embedding_does_not_read_are_ignored() -> None:
    names = ("q", "unread", "p")
    demos, embedding = random_demos((5, 5), names), linear(2, ("p", "q"))
    paths = embedded_paths(embedding, demos, np.array([1]))
    axes = plot_paths(paths).axes[0]
    np.testing.assert_allclose(ends(axes), demos.states[-1:, [2, 0]] * [2.0, 1.0])
    assert "unread" not in new_plot(paths_html(paths))[0][0]["hovertemplate"]
    for draw in (embedded_paths, plot_distance_against_time):
        with pytest.raises(PlanspaceError, match="'q' is missing"):
            draw(embedding, random_demos((5,), ("p", "other")), np.array([0]))


def new_plot(page: str) -> tuple[list[dict[str, Any]], dict[str, Any], dict[str, Any]]:
    """The traces, layout and configuration that the page passes to Plotly."""
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
def test_the_page_contains_each_state_with_its_name_and_unit(z_dim: int) -> None:
    demos = random_demos((4, 6, 5))
    (lines, marks), _, config = new_plot(paths_html(embedded_paths(linear(z_dim), demos, np.array([0, 2]))))
    rows = lines["customdata"]
    assert rows[4] == rows[10] == [None] * 8  # a gap, so that no line joins two demonstrations
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


def test_the_page_is_self_contained_and_loads_nothing() -> None:
    page = paths_html(embedded_paths(linear(3), random_demos((4, 4)), np.arange(2)))
    assert page.count("newPlot(") >= 1 and len(page) > 1_000_000  # it contains Plotly's script
    rest = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"https?://|\bsrc=|\bhref=|@import|url\(", rest)
    assert not re.search(r"<script[^>]*\bsrc=", page)
    assert "default-src 'none'" in " ".join(page.split())


def test_names_are_escaped_in_the_page() -> None:
    names = ("</script><b>x</b>", "%{customdata[1]}")
    demos = random_demos((4,), names, problem="<i>&")
    page = paths_html(embedded_paths(linear(2, names), demos, np.array([0])))
    (lines, _), _, _ = new_plot(page)
    shown = html.unescape(lines["hovertemplate"].replace("<br>", "\n").replace("<extra></extra>", ""))
    assert shown.splitlines()[2:] == [
        "</script><b>x</b> %{customdata[3]:.3f} m",
        "%{customdata[1]} %{customdata[4]:.3f} ",
    ]
    assert "%{customdata[1]} %" not in lines["hovertemplate"]  # Plotly would replace it
    assert "<title>A demonstration of &lt;i&gt;&amp; in plan space (z has 2 dimensions)</title>" in page


def test_the_number_of_demonstrations_in_the_page_is_limited() -> None:
    demos = random_demos((3,) * (MAX_INTERACTIVE + 3))
    paths = embedded_paths(linear(2), demos, np.arange(len(demos)), MAX_INTERACTIVE)
    (lines, marks), _, _ = new_plot(paths_html(paths))
    assert len(marks["x"]) == MAX_INTERACTIVE
    assert {row[0] for row in lines["customdata"]} - {None} == set(range(MAX_INTERACTIVE))


def test_a_constant_z_is_drawn_at_distance_zero() -> None:
    embedding = linear(3)
    embedding.encoder[0][0][:] = 0.0
    demos = random_demos((4, 5))
    curves = plot_distance_against_time(embedding, demos, np.arange(2)).axes[0].collections[0].get_segments()
    assert all((c[:, 1] == 0).all() for c in curves)
    rendered(plot_paths(embedded_paths(embedding, demos, np.arange(2))))


def test_draw_a_trained_embedding(embedding: Embedding, demos: Demos) -> None:
    episodes = np.array(embedding.require_about().split["train"])
    paths = embedded_paths(embedding, demos, episodes)
    num_segments = sum(len(demos.episode(int(i)).states) - 1 for i in episodes)
    assert len(segments(rendered(plot_paths(paths)).axes[0])) == num_segments
    rendered(plot_distance_against_time(embedding, demos, episodes))
    hover = new_plot(paths_html(paths))[0][0]["hovertemplate"]
    assert all(f"<br>{name} %" in hover for name in ("slider", "hinge", "slidervel", "hingevel"))
