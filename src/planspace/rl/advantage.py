"""Generalised advantage estimation (Schulman et al. 2016), which tells terminated from truncated."""

import numpy as np
from jaxtyping import Bool, Float


def gae(
    reward: Float[np.ndarray, "time *env"],
    value: Float[np.ndarray, "time *env"],
    next_value: Float[np.ndarray, "time *env"],
    terminated: Bool[np.ndarray, "time *env"],
    truncated: Bool[np.ndarray, "time *env"],
    *,
    discount: float,
    gae_lambda: float,
) -> Float[np.ndarray, "time *env"]:
    """Advantages of the actions taken.

    Args:
        reward: reward of each step.
        value: value of the state before each step.
        next_value: value of the state after each step; ignored where the episode terminated.
        terminated: whether the episode ended there; no reward follows.
        truncated: whether the record ends there; `next_value` stands for the rewards that would follow.
        discount: discount factor gamma.
        gae_lambda: lambda.
    """
    delta = reward + discount * np.where(terminated, 0.0, next_value) - value
    carry = discount * gae_lambda * ~(terminated | truncated)
    return _accumulate(delta, carry)


def discounted_returns(
    reward: Float[np.ndarray, "time *env"],
    next_value: Float[np.ndarray, "time *env"],
    terminated: Bool[np.ndarray, "time *env"],
    truncated: Bool[np.ndarray, "time *env"],
    *,
    discount: float,
) -> Float[np.ndarray, "time *env"]:
    """Discounted sum of rewards from each step on, with `next_value` where the record is truncated."""
    cut = truncated & ~terminated
    return _accumulate(
        reward + discount * np.where(cut, next_value, 0.0), discount * ~(terminated | truncated)
    )


def _accumulate(terms: np.ndarray, carry: np.ndarray) -> np.ndarray:
    """y_t = terms_t + carry_t y_{t+1}."""
    total = np.zeros_like(terms[0])
    result = np.empty_like(terms)
    for t in range(len(terms) - 1, -1, -1):
        total = terms[t] + carry[t] * total
        result[t] = total
    return result
