"""Statistics over seeds: final returns, confidence intervals, and verdicts on claims.

Intervals are 95 % bootstrap intervals, widened for few seeds by the ratio of Student's t to the normal
quantile. Two arms are compared in pairs of equal seeds, because a seed has the same starts and noise in both
arms. If seeds use several embeddings in turn, the bootstrap draws embeddings first and then seeds of each
embedding, so that the interval includes the variation between embeddings. If two arms have different numbers
of embeddings, the smaller number is used. The probability of improvement and the mean over tasks treat seeds
as independent.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float, Int

from planspace.errors import PlanspaceError
from planspace.study.design import Arm, Claim, Measure
from planspace.study.results import PoliciesResult

RESAMPLES = 5000
CONFIDENCE = 0.95
FINAL_STEPS, FINAL_FRACTION = 200_000, 0.25
"""The final return of a seed is its mean return over this many last steps (50 iterations of 4000 steps), but
at most over this last fraction of the training."""
EARLY_FRACTION = 0.25
"""The early return of a seed is its mean return over this first fraction of the training."""
NUM_BEST = 2
"""The best case is the mean over this many seeds: the paper's figures show the best and the second best."""
VISIBLE_RATIO = {15: 1.73, 30: 1.45, 50: 1.33, 75: 1.26, 100: 1.22}
"""The smallest ratio of the standard deviations of two normal samples that is significant at 95 %
(two-sided), by the number of seeds."""

Interval = tuple[float, float]


class Reached(NamedTuple):
    """Statistics of each seed, computed from its full training."""

    final: Float[np.ndarray, " seed"]
    early: Float[np.ndarray, " seed"]
    whole: Float[np.ndarray, " seed"]
    steps_to_solved: Float[np.ndarray, " seed"]
    """Infinite if a seed never solved its task."""


@dataclass(frozen=True)
class Scores:
    """The seeds of an arm that have been run so far."""

    seeds: tuple[int, ...]
    steps: Int[np.ndarray, " row"]
    """Environment steps of a seed at the end of each row."""
    returns: Float[np.ndarray, "row seed"]
    """Mean return of the iterations of each row."""
    num_embeddings: int
    """Number of embeddings that the seeds use in turn: seed s uses embedding s modulo this number."""
    diverged: tuple[bool, ...] = ()
    """Whether each seed diverged."""
    evaluation: Float[np.ndarray, " seed"] | None = None
    """Mean return of each seed's last evaluation."""
    reached: Reached | None = None
    """Given if `returns` has fewer rows than the training."""

    @classmethod
    def of(cls, arm: Arm, found: Sequence[PoliciesResult], *, evaluated: bool = False) -> "Scores":
        """Join the blocks of an arm, in the order of their seeds. `evaluated`: rows are evaluations.

        Raises:
            PlanspaceError: two blocks have different numbers of steps, or contain the same seed.
        """
        found = sorted(found, key=lambda result: result.seeds[0])
        seeds = tuple(seed for result in found for seed in result.seeds)
        if len(set(seeds)) < len(seeds) or len({result.steps for result in found}) > 1:
            raise PlanspaceError(f"the blocks of {arm.name} do not fit together.")
        last = [result.eval_returns[-1] if result.eval_returns else [] for result in found]
        evaluation = np.array([np.nan if x is None else x for block in last for x in block], dtype=float)
        rows = [result.eval_returns if evaluated else result.returns for result in found]
        return cls(
            seeds,
            np.array(found[0].eval_steps if evaluated else found[0].steps),
            np.concatenate([np.array(block, dtype=float) for block in rows], axis=1),
            arm.num_embeddings,
            tuple(x for result in found for x in result.frozen),
            evaluation if len(evaluation) == len(seeds) else None,
        )

    def of_seeds(self, seeds: Sequence[int]) -> "Scores":
        """The scores of some of the seeds."""
        columns = [self.seeds.index(seed) for seed in seeds]
        return replace(
            self,
            seeds=tuple(seeds),
            returns=self.returns[:, columns],
            diverged=tuple(self.diverged[i] for i in columns) if self.diverged else (),
            evaluation=None if self.evaluation is None else self.evaluation[columns],
            reached=None if self.reached is None else Reached(*(x[columns] for x in self.reached)),
        )


# --- one number per seed --------------------------------------------------------------------------------


def final(scores: Scores) -> Float[np.ndarray, " seed"]:
    """Final return of each seed: its mean return over the last `FINAL_STEPS`."""
    if scores.reached is not None:
        return scores.reached.final
    return _mean_between(scores, 1.0 - min(FINAL_STEPS / scores.steps[-1], FINAL_FRACTION), 1.0)


def early(scores: Scores) -> Float[np.ndarray, " seed"]:
    """Mean return of each seed over the first quarter of the training."""
    if scores.reached is not None:
        return scores.reached.early
    return _mean_between(scores, 0.0, EARLY_FRACTION)


def whole(scores: Scores) -> Float[np.ndarray, " seed"]:
    """Mean return of each seed over the whole training: the area under its curve divided by the steps."""
    if scores.reached is not None:
        return scores.reached.whole
    return _mean_between(scores, 0.0, 1.0)


def steps_to(scores: Scores, threshold: float, window: int = 2) -> Float[np.ndarray, " seed"]:
    """Steps until the mean of `window` rows first exceeds a threshold; infinite if it never does."""
    if scores.reached is not None:
        return scores.reached.steps_to_solved
    summed = np.cumsum(np.insert(scores.returns, 0, 0.0, axis=0), axis=0)
    width = min(window, len(scores.returns))
    above = (summed[width:] - summed[:-width]) / width > threshold
    first = above.argmax(axis=0) + width - 1
    return np.where(above.any(axis=0), scores.steps[first].astype(float), np.inf)


def _mean_between(scores: Scores, low: float, high: float) -> Float[np.ndarray, " seed"]:
    ends = scores.steps / scores.steps[-1]
    rows = (ends > low + 1e-9) & (ends <= high + 1e-9)
    rows[0 if high < 1.0 else -1] = True  # at least the first or the last row of a short training
    weights = np.diff(scores.steps, prepend=0)[rows]
    return np.average(scores.returns[rows], axis=0, weights=weights)


# --- numbers over seeds ---------------------------------------------------------------------------------


def mean(x: Float[np.ndarray, "*batch seed"]) -> Float[np.ndarray, "*batch"]:
    """Mean over seeds."""
    return np.asarray(np.mean(x, axis=-1))


def iqm(x: Float[np.ndarray, "*batch seed"]) -> Float[np.ndarray, "*batch"]:
    """Interquartile mean: the mean of the middle half of the seeds (Agarwal et al. 2021)."""
    return np.asarray(scipy.stats.trim_mean(x, 0.25, axis=-1))


def best(x: Float[np.ndarray, "*batch seed"]) -> Float[np.ndarray, "*batch"]:
    """Mean of the `NUM_BEST` best seeds."""
    return np.asarray(np.sort(x, axis=-1)[..., -NUM_BEST:].mean(axis=-1))


def log_std(x: Float[np.ndarray, "*batch seed"]) -> Float[np.ndarray, "*batch"]:
    """Logarithm of the standard deviation over seeds, which is at least 1e-9."""
    return np.asarray(np.log(np.maximum(np.std(x, axis=-1, ddof=min(1, x.shape[-1] - 1)), 1e-9)))


def interval(
    scores: Scores, number: Callable[[np.ndarray], np.ndarray], x: Float[np.ndarray, " seed"]
) -> Interval:
    """95 % interval of a statistic over seeds."""
    drawn = _draws(scores.seeds, scores.num_embeddings)
    return _widened(float(number(x)), number(x[drawn]), len(x), scores.num_embeddings)


def iqm_over_tasks(samples: Sequence[Float[np.ndarray, " seed"]]) -> tuple[float, Interval]:
    """Interquartile mean over all seeds of all tasks, and its interval; seeds are drawn within each task.

    Args:
        samples: the normalised scores of each task.
    """

    def number(*drawn: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.asarray(scipy.stats.trim_mean(np.concatenate(drawn, axis=axis), 0.25, axis=axis))

    value = float(number(*samples))
    if min(map(len, samples)) < 2:  # nothing to draw from, as in `interval`
        return value, (value, value)
    return value, _bootstrapped(samples, number, RESAMPLES)


def probability_of_improvement(
    arm: Float[np.ndarray, " seed"], other: Float[np.ndarray, " other_seed"]
) -> tuple[float, Interval]:
    """Probability that a seed of `arm` is better than a seed of `other`; ties count half (Mann-Whitney).

    A single seed says nothing about others: its interval is all of 0 to 1.
    """

    def number(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
        pairs = np.sign(a[..., :, None] - b[..., None, :])
        return np.asarray((1.0 + pairs.mean(axis=(-2, -1))) / 2.0)

    single = min(len(arm), len(other)) < 2
    return float(number(arm, other)), (0.0, 1.0) if single else _bootstrapped((arm, other), number, 1000)


def _bootstrapped(samples: Sequence[np.ndarray], number: Callable[..., np.ndarray], num: int) -> Interval:
    rng = np.random.default_rng(0)
    found = scipy.stats.bootstrap(tuple(samples), number, n_resamples=num, method="percentile", rng=rng)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def profile(
    x: Float[np.ndarray, " seed"], thresholds: Float[np.ndarray, " threshold"]
) -> Float[np.ndarray, " threshold"]:
    """Performance profile: the fraction of seeds above each threshold."""
    return np.asarray((x[:, None] > thresholds).mean(axis=0))


def variance_components(scores: Scores, x: Float[np.ndarray, " seed"]) -> tuple[float, float] | None:
    """Standard deviations between embeddings and between policies of an embedding (one-way random effects).

    Returns:
        Both; None with fewer than two embeddings, or without equal numbers of at least two policies each.
    """
    groups = [
        x[[i for i, seed in enumerate(scores.seeds) if seed % scores.num_embeddings == g]]
        for g in range(scores.num_embeddings)
    ]
    sizes = {len(group) for group in groups}
    if len(groups) < 2 or len(sizes) > 1 or min(sizes) < 2:
        return None
    (size,) = sizes
    within = float(np.mean([group.var(ddof=1) for group in groups]))
    between = float(np.var([group.mean() for group in groups], ddof=1))
    return float(np.sqrt(max(between - within / size, 0.0))), float(np.sqrt(within))


def log_std_ratio(scores: Scores, base: Scores) -> tuple[float, Interval]:
    """Logarithm of the ratio of standard deviations, `base` over `scores`; both have the same seeds."""
    return _compare("spread", scores, base)


# --- claims ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """A verdict on a claim, with the number that decided it."""

    number: float
    interval: Interval
    seeds: int
    """Number of seeds that decided the claim."""
    verdict: str
    """holds, does not hold, or cannot tell."""


MIN_SEEDS = 5
"""With fewer seeds, the verdict is `OPEN`: a bootstrap of so few seeds underestimates the variation."""
HOLDS, FAILS, OPEN = "holds", "does not hold", "cannot tell"


def judge(claim: Claim, arm: Scores, other: Scores | None) -> Verdict:
    """Decide a claim; see `Claim`.

    Args:
        claim: the claim.
        arm: scores of the claim's arm.
        other: scores of the arm that it is compared with, if any. Only shared seeds are used.
    """
    shared = tuple(seed for seed in arm.seeds if other is None or seed in other.seeds)
    if len(shared) < MIN_SEEDS:
        return Verdict(np.nan, (np.nan, np.nan), len(shared), OPEN)
    other = None if other is None else other.of_seeds(shared)
    number, (low, high) = _compare(claim.measure, arm.of_seeds(shared), other)
    return Verdict(number, (low, high), len(shared), _verdict(claim, low, high))


def _compare(measure: Measure, arm: Scores, other: Scores | None) -> tuple[float, Interval]:
    """Difference of a measure between two arms with the same seeds, and its interval.

    A spread has the opposite sign, so that a smaller spread gives a larger number.
    """
    of_seeds, over_seeds, sign = _MEASURES[measure]
    groups = _groups(arm, other)
    drawn = _draws(arm.seeds, groups)
    x = of_seeds(arm)
    number, draws = over_seeds(x), over_seeds(x[drawn])
    if other is not None:
        y = of_seeds(other)
        number, draws = number - over_seeds(y), draws - over_seeds(y[drawn])
    return float(sign * number), _widened(float(sign * number), sign * draws, len(x), groups)


def _verdict(claim: Claim, low: float, high: float) -> str:
    margin = claim.margin
    if claim.expects == "same":
        return HOLDS if -margin < low and high < margin else FAILS if low > margin or high < -margin else OPEN
    if claim.expects == "less":
        low, high = -high, -low
    return HOLDS if low > margin else FAILS if high < margin else OPEN


_MEASURES: dict[Measure, tuple[Callable[[Scores], np.ndarray], Callable[[np.ndarray], np.ndarray], int]] = {
    "final": (final, mean, 1),
    "early": (early, mean, 1),
    "whole": (whole, mean, 1),
    "best": (final, best, 1),
    "spread": (final, log_std, -1),  # claims are about less spread
    "early_spread": (early, log_std, -1),
}
"""For each measure: the number of a seed, the statistic over seeds, and the sign."""


@lru_cache(maxsize=64)
def _draws(seeds: tuple[int, ...], num_embeddings: int) -> Int[np.ndarray, "resample seed"]:
    """Indices of the seeds in each resample. Embeddings are drawn first, then seeds of each embedding."""
    rng = np.random.default_rng(0)
    if num_embeddings < 2:
        return rng.integers(len(seeds), size=(RESAMPLES, len(seeds)))
    groups = [np.flatnonzero(np.array(seeds) % num_embeddings == g) for g in range(num_embeddings)]
    groups = [group for group in groups if len(group)]
    sizes = np.array([len(group) for group in groups])
    table = np.array([np.resize(group, sizes.max()) for group in groups])
    chosen = rng.integers(len(groups), size=(RESAMPLES, len(groups), 1))
    within = rng.random((RESAMPLES, len(groups), sizes.max())) * sizes[chosen]
    return table[chosen, within.astype(int)].reshape(RESAMPLES, -1)


def _groups(arm: Scores, other: Scores | None) -> int:
    """Number of embeddings to draw from: the smaller one if both arms have several; 0 if neither has."""
    several = [x.num_embeddings for x in (arm, other) if x is not None and x.num_embeddings > 1]
    return min(several, default=0)


def _widened(number: float, draws: np.ndarray, num_seeds: int, num_embeddings: int) -> Interval:
    """Percentiles of the draws, widened for few seeds, or for few embeddings if there are several."""
    num = num_embeddings if num_embeddings > 1 else num_seeds
    tail = (1.0 - CONFIDENCE) / 2
    low, high = np.percentile(draws, [100 * tail, 100 * (1 - tail)])
    if num < 2:
        return float(low), float(high)
    student = float(scipy.stats.t.ppf(1 - tail, num - 1) / scipy.stats.norm.ppf(1 - tail))
    wider = student * np.sqrt(num / (num - 1))
    return float(number - wider * (number - low)), float(number + wider * (high - number))
