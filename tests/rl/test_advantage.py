import numpy as np
import pytest

from planspace.rl.advantage import discounted_returns, gae

NO, YES = False, True


def column(*values: float) -> np.ndarray:
    array = np.array(values)
    return (array if array.dtype == bool else array.astype(float))[:, None]


def test_gae_by_hand() -> None:
    # discount 1/2 and lambda 1/2: each advantage includes 1/4 of the next one
    # delta = 1 + 4/2 - 2 = 1;  2 + 6/2 - 4 = 1;  3 + 0 - 6 = -3 (terminated: next value ignored)
    # A_2 = -3;  A_1 = 1 - 3/4 = 1/4;  A_0 = 1 + (1/4)/4 = 1.0625
    advantage = gae(
        column(1, 2, 3),
        column(2, 4, 6),
        column(4, 6, 100),
        column(NO, NO, YES),
        column(NO, NO, NO),
        discount=0.5,
        gae_lambda=0.5,
    )
    np.testing.assert_allclose(advantage[:, 0], [1.0625, 0.25, -3.0])


def test_truncation_bootstraps_and_ends_the_sum() -> None:
    # step 0 is truncated with next value 10: delta = 1 + 5 - 2 = 4; step 1 does not affect it
    advantage = gae(
        column(1, 7),
        column(2, 1),
        column(10, 0),
        column(NO, YES),
        column(YES, NO),
        discount=0.5,
        gae_lambda=0.9,
    )
    np.testing.assert_allclose(advantage[:, 0], [4.0, 6.0])


def test_only_truncation_bootstraps() -> None:
    args = (column(1.0), column(2.0), column(10.0))
    ended = gae(*args, column(YES), column(NO), discount=0.9, gae_lambda=1.0)
    cut = gae(*args, column(NO), column(YES), discount=0.9, gae_lambda=1.0)
    assert cut[0, 0] - ended[0, 0] == pytest.approx(9.0)


def test_lambda_one_is_return_minus_value(rng: np.random.Generator) -> None:
    shape = (12, 3)
    reward, value = rng.normal(size=shape), rng.normal(size=shape)
    next_value = np.vstack([value[1:], rng.normal(size=(1, 3))])
    terminated, truncated = rng.random(shape) < 0.15, np.zeros(shape, bool)
    truncated[-1] = True
    advantage = gae(reward, value, next_value, terminated, truncated, discount=0.97, gae_lambda=1.0)
    returns = discounted_returns(reward, next_value, terminated, truncated, discount=0.97)
    np.testing.assert_allclose(advantage, returns - value)


def test_returns_by_hand() -> None:
    # discount 1/2, from the last step back: 4; 2 + 4/2 = 4; 1, because its episode ends there
    returns = discounted_returns(
        column(1, 2, 4), column(9, 9, 9), column(YES, NO, YES), column(NO, NO, NO), discount=0.5
    )
    np.testing.assert_allclose(returns[:, 0], [1.0, 4.0, 4.0])
    cut = discounted_returns(column(1), column(8), column(NO), column(YES), discount=0.5)
    assert cut[0, 0] == 5.0
