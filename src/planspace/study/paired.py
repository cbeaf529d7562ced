"""The difference of two success rates from the same starts, with its 95 % interval."""

from collections.abc import Sequence

import numpy as np
import scipy.stats

CONFIDENCE = 0.95


def success_difference(first: Sequence[bool], second: Sequence[bool]) -> tuple[float, tuple[float, float]]:
    """Fraction of starts from which `first` succeeds minus the same for `second`, and its 95 % interval.

    The interval is Newcombe's for paired proportions: the Wilson intervals of both fractions are combined as
    if their errors were correlated like the successes. It stays within -1 and 1 and has a width above 0 where
    a fraction is 0 or 1, where a bootstrap would draw the same number again and again.

    Source: Newcombe, Statistics in Medicine 17 (1998) 2635-2650, method 10.

    Args:
        first: whether each start succeeded.
        second: the same for the same starts, in the same order.

    Returns:
        The difference, and the lower and upper end of its interval.
    """
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    p, (p_low, p_high) = _wilson(a)
    q, (q_low, q_high) = _wilson(b)
    phi, difference = _correlation(a, b), p - q
    down = (p - p_low) ** 2 - 2 * phi * (p - p_low) * (q_high - q) + (q_high - q) ** 2
    up = (p_high - p) ** 2 - 2 * phi * (p_high - p) * (q - q_low) + (q - q_low) ** 2
    low, high = difference - np.sqrt(max(down, 0.0)), difference + np.sqrt(max(up, 0.0))
    return difference, (max(float(low), -1.0), min(float(high), 1.0))


def _wilson(successes: np.ndarray) -> tuple[float, tuple[float, float]]:
    """The fraction of successes, and its Wilson interval."""
    found = scipy.stats.binomtest(int(successes.sum()), len(successes))
    low, high = found.proportion_ci(CONFIDENCE, method="wilson")
    return float(successes.mean()), (float(low), float(high))


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Newcombe's phi: the correlation of the successes, with a continuity correction if it is positive."""
    both, neither, only_a, only_b = ((x & y).sum() for x, y in ((a, b), (~a, ~b), (a, ~b), (~a, b)))
    margins = float(a.sum()) * float((~a).sum()) * float(b.sum()) * float((~b).sum())
    if margins == 0:
        return 0.0
    excess = float(both * neither - only_a * only_b)
    corrected = max(excess - len(a) / 2, 0.0) if excess > 0 else excess
    return corrected / np.sqrt(margins)
