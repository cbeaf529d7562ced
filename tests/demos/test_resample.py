import numpy as np
import pytest

from planspace.demos.episode import Episode
from planspace.demos.recording import recorded
from planspace.demos.resample import common_step, resample, with_continuous_angles
from planspace.demos.state_info import StateInfo
from planspace.mjcf.assets import ASSETS

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


def test_states_between_the_recorded_ones_and_the_control_in_force() -> None:
    # Steps of 0.2 counted back from the end at 0.7: 0.1, 0.3, 0.5, 0.7, on a clock that starts at 0.
    # x = 10 t up to t = 0.4, where it is 4, then it stands still.
    # Controls: 1 is held from 0, 2 from 0.1, 3 from 0.4; so 2 at 0.1, 2 at 0.3, 3 at 0.5.
    e = resample(episode([0.0, 0.1, 0.4, 0.7], [0.0, 1.0, 4.0, 4.0]), INFO, 0.2)
    np.testing.assert_allclose(e.times, [0.0, 0.2, 0.4, 0.6])
    np.testing.assert_allclose(e.states[:, 0], [1.0, 3.0, 4.0, 4.0])
    assert e.controls[:, 0].tolist() == [2.0, 2.0, 3.0]


def test_the_step_is_the_median_of_all_steps_or_none_where_all_are_alike() -> None:
    # steps 0.1 0.1 0.1 0.2 0.3: median 0.1
    uneven = [episode([0.0, 0.1, 0.2, 0.3]), episode([0.0, 0.2, 0.5])]
    assert step_of(uneven) == pytest.approx(0.1)
    assert step_of([episode([0.0, 0.1, 0.2]), episode([0.0, 0.1])]) is None
    # two demonstrations, each even in itself, at different rates: a step must last as long everywhere
    assert step_of([episode([0.0, 0.1, 0.2, 0.3]), episode([0.0, 0.2])]) == pytest.approx(0.1)


def test_a_clock_rounded_to_float32_is_even() -> None:
    times = np.cumsum(np.full(500, 0.02)).astype(np.float32).astype(float)
    assert step_of([episode(times.tolist())]) is None


def test_the_step_is_a_whole_number_of_the_models_steps() -> None:
    info = StateInfo(("x",), ("",), (), 1, joints=("slider", "hinge"), mjcf=MJCF)  # steps of 0.02 s
    assert step_of([episode([0.0, 0.05, 0.1, 0.2])], info) == pytest.approx(0.04)
    assert step_of([episode([0.0, 0.003, 0.006, 0.02])], info) == pytest.approx(0.02)


def test_an_even_episode_and_one_shorter_than_a_step_stay_as_they_are() -> None:
    even, short = episode([0.0, 0.1, 0.2]), episode([0.0, 0.05])
    assert resample(even, INFO, 0.1) is even
    assert resample(short, INFO, 0.1) is short


def test_resampling_twice_changes_nothing() -> None:
    once = resample(episode([0.0, 0.1, 0.25, 0.3, 0.47]), INFO, 0.1)
    assert resample(once, INFO, 0.1) is once


def test_a_wrapped_angle_is_joined_and_ends_in_one_turn() -> None:
    # 3, then past pi: the file says -3 for 2 pi - 3
    np.testing.assert_allclose(angles([2.0, 3.0, -3.0]), [2 - 2 * np.pi, 3 - 2 * np.pi, -3.0])


def test_an_angle_wound_up_is_shifted_but_not_otherwise_changed() -> None:
    wound = [0.0, 3.0, 6.5, 10.0]  # jumps beyond pi, but over more than a turn: no file wrapped it
    np.testing.assert_allclose(angles(wound), np.array(wound) - 4 * np.pi)
    assert angles(wound, keep_windings=True).tolist() == wound


def test_an_angle_that_ends_in_one_turn_keeps_its_last_bit() -> None:
    x = [5.0, 2.5, 0.1 + 0.2]
    assert angles(x).tolist() == x
    assert angles([1.0, np.pi]).tolist() == [1.0, np.pi]


def test_a_quaternion_keeps_its_sign_and_its_length() -> None:
    # turns of 0, 90 and 180 degrees about z; the file has the last one as its negative
    info = StateInfo(("w", "x", "y", "z"), ("",) * 4, (), 1, quaternion_columns=(0,))
    half = np.sqrt(0.5)
    states = np.array([[1.0, 0, 0, 0], [half, 0, 0, half], [0, 0, 0, -1.0]])
    e = with_continuous_angles(
        recorded(states, np.zeros((2, 1)), np.array([0, 0.1, 0.3]), 0), info, keep_windings=False
    )
    assert e.states[2].tolist() == [0, 0, 0, 1]
    # Halfway between 90 and 180 degrees, by symmetry, are 135: (cos 67.5, 0, 0, sin 67.5)
    middle = resample(e, info, 0.1).states[2]
    np.testing.assert_allclose(middle, [np.cos(np.radians(67.5)), 0, 0, np.sin(np.radians(67.5))], atol=1e-12)
