import io
from pathlib import Path
from typing import Any

import matplotlib.colors
import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from planspace.embed.training_log import LogRow, read_log
from planspace.errors import PlanspaceError
from planspace.figures.training_curves import plot_training, rolling


def log(num_rows: int = 40, num_seeds: int = 3) -> list[LogRow]:
    rng = np.random.default_rng(0)
    return [
        {
            "step": 500 * (i + 1),
            "time": 1.0,
            "bound": (rng.normal(size=num_seeds) - 100 / (i + 10)).tolist(),
            "path_error": rng.uniform(0.1, 0.3, num_seeds).tolist(),
        }
        for i in range(num_rows)
    ]


def bands(axes: Any) -> list[np.ndarray]:
    return [np.asarray(c.get_paths()[0].vertices) for c in axes.collections if isinstance(c, PolyCollection)]


def test_rolling_by_hand() -> None:
    mean, low, high = rolling(np.array([[1.0], [4.0], [1.0], [7.0]]), 3)
    np.testing.assert_allclose(mean[:, 0], [2.5, 2.0, 4.0, 4.0])
    np.testing.assert_allclose(low[:, 0], [1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(high[:, 0], [4.0, 4.0, 7.0, 7.0])


def test_one_curve_per_seed_lies_within_its_band() -> None:
    rows = log()
    figure = plot_training(rows, 1, [7, 8, 9])
    figure.savefig(io.BytesIO(), format="png", dpi=30)
    for axes, name in zip(figure.axes, ("path_error", "bound"), strict=True):
        assert [line.get_label() for line in axes.lines] == ["seed 7", "seed 8, selected", "seed 9"]
        assert axes.get_xlabel() == "optimiser steps"
        for i, (line, band) in enumerate(zip(axes.lines, bands(axes), strict=True)):
            steps, mean = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
            np.testing.assert_array_equal(steps, [row["step"] for row in rows])
            raw = np.array([row[name][i] for row in rows])
            np.testing.assert_allclose(mean[1:-1], (raw[:-2] + raw[1:-1] + raw[2:]) / 3)  # 3 rows of 40
            for step, value, unsmoothed in zip(steps, mean, raw, strict=True):
                at = band[band[:, 0] == step, 1]
                assert at.min() < value < at.max()
                assert at.min() <= unsmoothed <= at.max()
    widths = [line.get_linewidth() for line in figure.axes[0].lines]
    assert widths[1] > widths[0] == widths[2]


def test_seeds_have_distinct_colours_and_are_numbered_from_0_by_default() -> None:
    figure = plot_training(log(num_seeds=5))
    lines = figure.axes[0].lines
    assert len({matplotlib.colors.to_hex(line.get_color()) for line in lines}) == 5
    assert [line.get_label() for line in lines] == [f"seed {i}" for i in range(5)]
    assert len({line.get_linewidth() for line in lines}) == 1
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [f"seed {i}" for i in range(5)]


def test_longer_logs_are_smoothed_over_more_rows() -> None:
    assert "over 3 log rows" in plot_training(log(12)).get_suptitle()
    assert "over 21 log rows" in plot_training(log(400)).get_suptitle()


def test_extreme_values_at_the_start_are_clipped() -> None:
    rows = log()
    calm = plot_training(rows).axes[1].get_ylim()
    assert calm[0] < min(min(row["bound"]) for row in rows)  # nothing is clipped
    rows[0]["bound"] = [-1e6] * 3
    bottom, top = plot_training(rows).axes[1].get_ylim()
    assert -40 < bottom < min(min(row["bound"]) for row in rows[10:]) and 0 < top < 10


def test_draw_a_log_of_one_row() -> None:
    figure = plot_training(log(1), 0)
    figure.savefig(io.BytesIO(), format="svg")
    assert [np.size(line.get_xdata()) for line in figure.axes[0].lines] == [1, 1, 1]
    assert {line.get_marker() for line in figure.axes[0].lines} == {
        "o"
    }  # a line through one point is invisible


@pytest.mark.parametrize("rows", [[], [{"step": 1, "bound": [1.0]}]])
def test_a_log_without_a_path_error_is_an_error(rows: list[LogRow]) -> None:
    with pytest.raises(PlanspaceError, match="no row with 'path_error'"):
        plot_training(rows)


def test_draw_the_log_of_a_training(embedding_folder: Path) -> None:
    rows = read_log(embedding_folder)
    assert [row["step"] for row in rows] == sorted({row["step"] for row in rows})
    assert len(plot_training(rows, 0, [0, 1]).axes[1].lines) == 2
