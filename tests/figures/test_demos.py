import io

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.recording import recorded
from planspace.demos.state_info import StateInfo
from planspace.figures.demos import plot_demos

BALL = tuple(f"ball_{axis}" for axis in ("w", "x", "y", "z"))
SEVEN = tuple(f"joint{i}" for i in range(7))


def labels(names: tuple[str, ...]) -> list[tuple[str, str]]:
    info = StateInfo(names, ("",) * len(names), (), 0)
    states = np.random.default_rng(0).normal(size=(4, len(names)))
    figure = plot_demos(Demos.from_episodes(info, [recorded(states, np.zeros((3, 0)), np.arange(4.0), 0)]))
    figure.savefig(io.BytesIO(), format="png", dpi=20)
    return [
        (axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes[:-1]
    ]  # the last one is the colour scale


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("x", "xvel"), [("x", "xvel")]),
        (("a", "avel", "b"), [("a", "avel"), ("time [s]", "b")]),
        (("xvel",), [("time [s]", "xvel")]),  # a velocity without a position
        ((*BALL, "velx", "vely", "velz"), [("time [s]", n) for n in (*BALL, "velx", "vely", "velz")]),
        ((*SEVEN, *(f"{n}vel" for n in SEVEN)), [(n, f"{n}vel") for n in SEVEN]),
    ],
)
def test_positions_are_paired_with_their_velocities_by_name(names, expected) -> None:
    assert labels(names) == expected


def test_four_panels_per_row() -> None:
    info = StateInfo(SEVEN, ("rad",) * 7, (), 0)
    episode = recorded(np.zeros((3, 7)), np.zeros((2, 0)), np.arange(3.0), 0)
    figure = plot_demos(Demos.from_episodes(info, [episode]))
    assert figure.get_size_inches().tolist() == [5.2 * 4, 4.2 * 2]
    assert len(figure.axes) == 7 + 1  # seven panels, no empty eighth, and the colour scale
    assert figure.axes[0].get_ylabel() == "joint0 [rad]"
