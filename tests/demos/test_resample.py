import numpy as np
import pytest

from planspace.demos.episode import Episode
from planspace.demos.recording import recorded
from planspace.demos.resample import common_step, resample, with_continuous_angles
from planspace.demos.state_info import StateInfo
from planspace.mjcf.assets import ASSETS
from planspace.mjcf.source import ModelSource

MJCF = (ASSETS / "cartpole.xml").read_text()
INFO = StateInfo(("x",), ("",), (), 1)
CIRCLE = StateInfo(("angle",), ("rad",), (0,), 1)


def episode(times: list[float], states: list[float] | None = None):
    x = np.array(times if states is None else states)[:, None]
    return recorded(x, np.arange(1.0, len(times))[:, None], np.array(times), 0)


def angles(values: list[float], *, keep_windings: bool = False) -> np.ndarray:
    e = episode(list(np.arange(len(values)) * 1.0), values)
    return with_continuous_angles(e, CIRCLE, keep_windings=keep_windings).states[:, 0]


def step_of(episodes: list[Episode], info: StateInfo = INFO) -> float | None:
    return common_step(lambda: (np.diff(e.times) for e in episodes), info)


def test_states_are_interpolated_and_controls_are_held() -> None:
    # Steps of 0.2 counted back from the end at 0.7: 0.1, 0.3, 0.5, 0.7, on a clock that starts at 0.
    # x = 10 t up to t = 0.4, where it is 4, then it is constant.
    # Controls: 1 is held from 0, 2 from 0.1, 3 from 0.4; so 2 at 0.1, 2 at 0.3, 3 at 0.5.
    e = resample(episode([0.0, 0.1, 0.4, 0.7], [0.0, 1.0, 4.0, 4.0]), INFO, 0.2)
    np.testing.assert_allclose(e.times, [0.0, 0.2, 0.4, 0.6])
    np.testing.assert_allclose(e.states[:, 0], [1.0, 3.0, 4.0, 4.0])
    assert e.controls[:, 0].tolist() == [2.0, 2.0, 3.0]


def test_the_step_is_the_median_unless_all_steps_are_equal() -> None:
    # steps 0.1 0.1 0.1 0.2 0.3: median 0.1
    uneven = [episode([0.0, 0.1, 0.2, 0.3]), episode([0.0, 0.2, 0.5])]
    assert step_of(uneven) == pytest.approx(0.1)
    assert step_of([episode([0.0, 0.1, 0.2]), episode([0.0, 0.1])]) is None
    # each of the two demonstrations has even steps, but they differ
    assert step_of([episode([0.0, 0.1, 0.2, 0.3]), episode([0.0, 0.2])]) == pytest.approx(0.1)


def test_times_rounded_to_float32_are_even() -> None:
    times = np.cumsum(np.full(500, 0.02)).astype(np.float32).astype(float)
    assert step_of([episode(times.tolist())]) is None


def test_the_step_is_a_multiple_of_the_time_step_of_the_model() -> None:
    model = ModelSource(MJCF)  # steps of 0.02 s
    info = StateInfo(("x",), ("",), (), 1, joints=("slider", "hinge"), source=model)
    assert step_of([episode([0.0, 0.05, 0.1, 0.2])], info) == pytest.approx(0.04)
    assert step_of([episode([0.0, 0.003, 0.006, 0.02])], info) == pytest.approx(0.02)


def test_even_and_very_short_episodes_are_unchanged() -> None:
    even, short = episode([0.0, 0.1, 0.2]), episode([0.0, 0.05])
    assert resample(even, INFO, 0.1) is even
    assert resample(short, INFO, 0.1) is short


def test_resampling_twice_changes_nothing() -> None:
    once = resample(episode([0.0, 0.1, 0.25, 0.3, 0.47]), INFO, 0.1)
    assert resample(once, INFO, 0.1) is once


def test_a_wrapped_angle_is_unwrapped_and_ends_in_one_turn() -> None:
    # after 3 the angle passes pi: -3 means 2 pi - 3
    np.testing.assert_allclose(angles([2.0, 3.0, -3.0]), [2 - 2 * np.pi, 3 - 2 * np.pi, -3.0])


def test_an_angle_with_full_turns_is_only_shifted() -> None:
    angle = [0.0, 3.0, 6.5, 10.0]  # its range exceeds one turn, so the jump beyond pi is not from wrapping
    np.testing.assert_allclose(angles(angle), np.array(angle) - 4 * np.pi)
    assert angles(angle, keep_windings=True).tolist() == angle


def test_an_angle_that_ends_in_one_turn_is_unchanged() -> None:
    x = [5.0, 2.5, 0.1 + 0.2]
    assert angles(x).tolist() == x
    assert angles([1.0, np.pi]).tolist() == [1.0, np.pi]


def test_quaternions_have_a_continuous_sign_and_unit_length() -> None:
    # rotations of 0, 90 and 180 degrees about z; the last one is stored with the opposite sign
    info = StateInfo(("w", "x", "y", "z"), ("",) * 4, (), 1, quaternion_columns=(0,))
    half = np.sqrt(0.5)
    states = np.array([[1.0, 0, 0, 0], [half, 0, 0, half], [0, 0, 0, -1.0]])
    e = with_continuous_angles(
        recorded(states, np.zeros((2, 1)), np.array([0, 0.1, 0.3]), 0), info, keep_windings=False
    )
    assert e.states[2].tolist() == [0, 0, 0, 1]
    # halfway between 90 and 180 degrees is 135: (cos 67.5, 0, 0, sin 67.5)
    middle = resample(e, info, 0.1).states[2]
    np.testing.assert_allclose(middle, [np.cos(np.radians(67.5)), 0, 0, np.sin(np.radians(67.5))], atol=1e-12)
