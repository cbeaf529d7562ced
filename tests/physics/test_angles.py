import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planspace.physics.angles import unwrap_to_end, wrap

ANGLES = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20).map(np.array)


def test_wrap_by_hand() -> None:
    # pi stays, -pi becomes pi; 3 pi / 2 is -pi / 2; 2 pi is 0
    given_angles = np.array([np.pi, -np.pi, 1.5 * np.pi, 2 * np.pi, 0.3])
    np.testing.assert_allclose(wrap(given_angles), [np.pi, np.pi, -0.5 * np.pi, 0.0, 0.3], atol=1e-12)


@given(ANGLES)
def test_wrapped_angles_are_in_range_and_have_the_same_direction(angles: np.ndarray) -> None:
    wrapped = wrap(angles)
    assert ((wrapped > -np.pi) & (wrapped <= np.pi)).all()
    np.testing.assert_allclose(np.sin(wrapped), np.sin(angles), atol=1e-9)
    np.testing.assert_allclose(np.cos(wrapped), np.cos(angles), atol=1e-9)


@given(ANGLES)
def test_unwrap_to_end_shifts_by_a_multiple_of_two_pi(angles: np.ndarray) -> None:
    shifted = unwrap_to_end(angles)
    assert -np.pi < shifted[-1] <= np.pi + 1e-9
    np.testing.assert_allclose(np.diff(shifted), np.diff(angles), atol=1e-9)  # still continuous
    turns = (shifted - angles) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns[0]), atol=1e-9)
