from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_npz
from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.load import load_demos
from planspace.demos.state_info import StateInfo
from planspace.embed.embedding import Embedding
from planspace.embed.geometry import (
    MAX_MIDPOINT_ERROR,
    Geometry,
    bootstrap_intervals,
    effective_rank,
    measure,
    measure_constant,
    measure_each,
    measure_raw_state,
    paper_path_errors,
    scaled_errors,
    summarise,
    tabulate,
)
from planspace.errors import PlanspaceError

INFO = StateInfo(("x", "y"), ("m", "m"), (), 1)


def demos_of(*paths: np.ndarray) -> Demos:
    return Demos.from_episodes(
        INFO,
        [
            Episode(z, np.zeros((len(z) - 1, 1)), np.arange(len(z)) * 0.1, np.zeros(2), True, i, 0)
            for i, z in enumerate(paths)
        ],
    )


def geometry_of(*paths: np.ndarray) -> Geometry:
    return summarise(measure_each(lambda x: x, lambda x: x, demos_of(*paths), np.arange(len(paths))))


def test_a_straight_line_at_constant_speed_is_perfect() -> None:
    line = np.linspace([0.0, 0.0], [3.0, 4.0], 25)
    g = geometry_of(line, 2 * line)
    assert g.straightness == pytest.approx(1.0)
    assert g.speed_variation == pytest.approx(0.0, abs=1e-9)
    assert g.midpoint_error == pytest.approx(0.0, abs=1e-9)
    assert g.time_correlation == pytest.approx(1.0)
    assert g.path_error == pytest.approx(0.0, abs=1e-9)  # chord and length are proportional
    assert g.effective_rank == pytest.approx(1.0)  # the only flaw: one dimension


def test_a_right_angle_by_hand() -> None:
    # 10 steps along x, then 10 along y, each of length 1: chord sqrt(200), path 20
    corner = np.array([[i, 0] for i in range(11)] + [[10, j] for j in range(1, 11)], float)
    g = geometry_of(corner)
    assert g.straightness == pytest.approx(np.sqrt(200) / 20)
    assert g.speed_variation == pytest.approx(0.0, abs=1e-12)
    # spacing 5: t from 5 to 15, with an error only from t = 6 to 14, where the corner is between a and b;
    # spacing 10: only t = 10
    five = [_corner_error(t, 5) for t in range(5, 16)]
    ten = [_corner_error(10, 10)]
    assert g.midpoint_error == pytest.approx((np.mean(five) + np.mean(ten)) / 2)


def _corner_error(t: int, s: int) -> float:
    def at(i: int) -> np.ndarray:
        return np.array([min(i, 10), max(i - 10, 0)], float)

    a, b = at(t - s), at(t + s)
    return float(np.linalg.norm(at(t) - (a + b) / 2) / np.linalg.norm(b - a))


def test_metrics_of_a_constant_z() -> None:
    paths = [np.random.default_rng(i).normal(size=(30 + i, 2)).cumsum(axis=0) for i in range(3)]
    demos = demos_of(*paths)
    g = measure_constant(demos, np.arange(3))
    assert (g.straightness, g.time_correlation, g.effective_rank, g.active_dims) == (0.0, 0.0, 0.0, 0)
    assert np.isnan([g.midpoint_error, g.speed_variation]).all()  # nothing moves, so nothing is perfect
    assert set(g.missing()) == {"midpoint_error", "speed_variation"}
    assert g.decoded_error == pytest.approx(1.0)  # the error of the mean state is the standard deviation
    duration = np.array([29, 30, 31]) * 0.1
    y = duration / duration.mean()
    assert g.duration_error == pytest.approx(np.abs(1 - y).mean())


def test_the_error_of_the_decoded_state_by_hand() -> None:
    states = np.random.default_rng(0).normal(size=(20, 2)) * [1.0, 10.0]
    off = states.std(axis=0) * [0.3, 0.4]  # mean square error (0.09 + 0.16) / 2
    table = measure_each(lambda x: x, lambda x: x + off, demos_of(states), np.array([0]))
    assert summarise(table).decoded_error == pytest.approx(np.sqrt(0.125))


def test_intervals_contain_the_value_and_shrink_with_more_demonstrations() -> None:
    rng = np.random.default_rng(0)
    paths = [np.linspace([0.0, 0.0], [1.0, 1.0], 20) + 0.05 * rng.normal(size=(20, 2)) for _ in range(100)]
    few, many = (
        measure_each(lambda x: x, lambda x: x, demos_of(*paths[:n]), np.arange(n)) for n in (10, 100)
    )
    widths = []
    for table in (few, many):
        low, high = bootstrap_intervals(table)["straightness"]
        assert low < summarise(table).straightness < high
        widths.append(high - low)
    assert widths[1] < 0.6 * widths[0]  # the expected factor is 1 / sqrt(10)
    mean, error = few.straightness.mean(), few.straightness.std() / np.sqrt(10)
    low, high = bootstrap_intervals(few)["straightness"]
    assert (low, high) == pytest.approx((mean - 1.96 * error, mean + 1.96 * error), abs=0.5 * error)


def test_the_fast_path_error_equals_the_measured_one(embedding: Embedding, demos: Demos) -> None:
    part = np.array([0, 3, 5])
    assert paper_path_errors([embedding], demos, part)[0] == pytest.approx(
        measure(embedding, demos, part).path_error
    )


def test_metrics_do_not_depend_on_the_order_of_the_states(embedding: Embedding, demos: Demos) -> None:
    shuffled = demos.select(("hingevel", "slider", "hinge", "slidervel"))
    assert shuffled.info.circular_columns == (2,)
    same = tabulate(embedding, shuffled, np.arange(3))
    np.testing.assert_allclose(same.chord, tabulate(embedding, demos, np.arange(3)).chord)


def test_the_scale_factor_minimises_the_squared_error() -> None:
    d, y = np.array([1.0, 2.0, 4.0]), np.array([2.0, 5.0, 7.0])
    best = np.sum((y / y.mean() - _scale(d, y) * d) ** 2)
    assert np.sum(scaled_errors(d, y) ** 2) == pytest.approx(best)
    for change in (-1e-3, 1e-3):
        assert np.sum((y / y.mean() - (_scale(d, y) + change) * d) ** 2) > best


def _scale(d: np.ndarray, y: np.ndarray) -> float:
    return float(np.sum(d * y / y.mean()) / np.sum(d**2))


def test_effective_rank_counts_equal_dimensions() -> None:
    assert effective_rank(np.eye(3)) == pytest.approx(3.0)
    assert effective_rank(np.diag([1.0, 1.0, 0.0])) == pytest.approx(2.0)


ANCHORS = {
    "cartpole_swingup.npz": (0.090, 1.275, 0.451, 0.348, 0.302),
    "reacher_limited.npz": (0.122, 0.985, 0.641, 0.561, 0.518),
}
"""Straightness, speed variation, midpoint error, time correlation; path error with d in raw numbers."""
ANCHOR_TOLERANCES = (1e-3, 1e-3, 6e-3, 1e-3, 1e-3)


@pytest.mark.parametrize("file", ANCHORS)
def test_raw_state_metrics_of_the_released_data(released: Path, file: str, tmp_path: Path) -> None:
    """They equal those of an independent implementation, on all released demonstrations."""
    import_npz(released / file, tmp_path / "demos", None)
    demos = load_demos(tmp_path / "demos")
    everything = np.arange(len(demos))
    g = measure_raw_state(demos, everything, everything)
    states = [demos.episode(i).states for i in range(len(demos))]
    chord = np.array([np.linalg.norm(x[-1] - x[0]) for x in states])
    length = np.array([np.linalg.norm(np.diff(x, axis=0), axis=1).sum() for x in states])
    path_error = scaled_errors(chord, length).mean()
    got = (g.straightness, g.speed_variation, g.midpoint_error, g.time_correlation, path_error)
    assert (np.abs(np.subtract(got, ANCHORS[file])) <= ANCHOR_TOLERANCES).all(), got


def test_demos_of_other_states_are_refused(embedding: Embedding) -> None:
    demos = demos_of(np.zeros((20, 2)) + np.arange(20)[:, None])
    with pytest.raises(
        PlanspaceError,
        match=r"the 4 states \(slider, .*\) of .* the 2 states \(x, y\): 'slider' is missing",
    ):
        measure(embedding, demos, np.array([0]))


def test_demos_too_short_to_measure_are_refused() -> None:
    with pytest.raises(PlanspaceError, match="no demonstration has the 12 states"):
        geometry_of(np.zeros((11, 2)))


def test_one_demonstration_has_no_path_error_and_no_intervals() -> None:
    """C is fitted to the one distance, so |C d - y| would be 0 for any encoder."""
    walk = np.random.default_rng(0).normal(size=(60, 2)).cumsum(axis=0)
    table = measure_each(lambda x: x, lambda x: x, demos_of(walk), np.array([0]))
    g = summarise(table)
    assert np.isnan([g.path_error, g.path_error_std, g.duration_error]).all()
    assert g.plain()["path_error"] is None and g.plain()["straightness"] == g.straightness
    assert set(g.missing()) == {"path_error", "path_error_std", "duration_error", "intervals"}
    assert bootstrap_intervals(table) == {}


def test_two_demonstrations_have_no_interval_of_the_path_error() -> None:
    """Drawn twice, one demonstration fits itself; both together have one value, an interval of no width."""
    paths = [np.random.default_rng(i).normal(size=(40, 2)).cumsum(axis=0) for i in range(3)]
    tables = [measure_each(lambda x: x, lambda x: x, demos_of(*paths[:n]), np.arange(n)) for n in (2, 3)]
    two, three = map(bootstrap_intervals, tables)
    assert set(three) - set(two) == {"path_error", "path_error_std", "duration_error"}
    assert list(summarise(tables[0]).missing()) == ["intervals"]
    low, high = three["path_error"]
    assert 0 < low < high  # draws of one demonstration three times do not count: their error would be 0


def test_the_midpoint_error_of_a_path_that_returns_is_bounded() -> None:
    """A circle of 20 steps: with a spacing of 10, a and b are the same point and t lies opposite."""
    angle = 2 * np.pi * np.arange(21) / 20
    g = geometry_of(np.column_stack([np.cos(angle), np.sin(angle)]))
    # spacing 5: a and b are opposite points at distance 2, t is at distance 1 from the centre
    assert g.midpoint_error == pytest.approx((0.5 + MAX_MIDPOINT_ERROR) / 2)


def test_standing_still_is_not_perfect() -> None:
    """The path waits for 30 of its 40 steps; only the triplets that move are measured."""
    moving = np.array(
        [[0.0, 0], [1, 1], [2, 0], [3, 1], [4, 0], [5, 1], [6, 0], [7, 1], [8, 0], [9, 1], [10, 0]]
    )
    waiting = np.concatenate([moving, np.tile(moving[-1], (30, 1))])
    a, t, b = waiting[:-10], waiting[5:-5], waiting[10:]
    measured = [
        np.linalg.norm(y - (x + z) / 2) / np.linalg.norm(z - x)
        for x, y, z in zip(a, t, b, strict=True)
        if np.linalg.norm(z - x) > 0
    ]
    assert len(measured) == 10
    g = geometry_of(waiting[:20])  # too short for a spacing of 10
    assert g.midpoint_error == pytest.approx(np.mean(measured))
    still = geometry_of(np.ones((20, 2)), np.linspace([0, 0], [1, 1], 20))
    assert (still.midpoint_error, still.speed_variation) == pytest.approx(
        (0.0, 0.0), abs=1e-9
    )  # of the other
    assert still.straightness == pytest.approx(0.5)


def test_z_of_any_scale_has_the_same_midpoint_error() -> None:
    """A floor of the distance would make a tiny z perfect."""
    walk = np.random.default_rng(0).normal(size=(60, 2)).cumsum(axis=0)
    for scale in (1e-30, 1e-12, 1.0, 1e12):
        assert geometry_of(scale * walk).midpoint_error == pytest.approx(geometry_of(walk).midpoint_error)


def test_a_number_that_hardly_moves_in_the_measured_demonstrations_does_not_blow_up_the_decoded_error() -> (
    None
):
    """x has a deviation of 1e-12 in the demonstration and of about 1 in the dataset; z is wrong by 0.02."""
    rng = np.random.default_rng(0)
    still, other = rng.normal(size=(20, 2)) * [1e-12, 1.0], rng.normal(size=(20, 2))
    demos = demos_of(still, other)
    table = measure_each(lambda x: x, lambda x: x + [0.02, 0.0], demos, np.array([0]))
    least = 0.01 * demos.states[:, 0].std()
    assert summarise(table).decoded_error == pytest.approx(0.02 / least / np.sqrt(2))


def test_no_demonstration_that_moves_has_no_path_error() -> None:
    g = geometry_of(np.ones((20, 2)), np.ones((20, 2)))
    assert np.isnan([g.path_error, g.midpoint_error]).all() and not np.isnan(g.duration_error)
    assert g.missing()["path_error"] == "no demonstration moves"
