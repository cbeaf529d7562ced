"""Statistics over seeds: what each arm reached, how sure that is, and what it decides.

Every interval is a bootstrap's, at 95 %, widened for few seeds as Student's t is. Two arms are compared seed
by seed: a seed's starts and noise are the same in both. Where seeds take several embeddings in turn,
embeddings are drawn first and then the seeds of each, so that an interval says what other embeddings would
bring, too; where two arms have different numbers of them, the smaller one counts. How often a seed of one arm
beats one of another, and what is put together over tasks, takes seeds for independent.
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
FINAL_STEPS, FINAL_SHARE = 200_000, 0.25
"""What a seed reached is its mean return over the last 50 iterations of 4000 steps, and at most over the last
quarter of a short training."""
EARLY_SHARE = 0.25
NUM_BEST = 2
"""The best case is the mean over this many seeds: the paper's figures show the best and the second best."""
VISIBLE_RATIO = {15: 1.73, 30: 1.45, 50: 1.33, 75: 1.26, 100: 1.22}
"""Two normal samples of this many seeds differ in their standard deviations beyond this ratio (two-sided, 95
%)."""

Interval = tuple[float, float]


class Reached(NamedTuple):
    """Numbers of each seed, computed from all rows of its training."""

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
    """Number of embeddings that the seeds take in turn; seeds of one embedding are equal modulo this."""
    diverged: tuple[bool, ...] = ()
    """Whether each seed diverged."""
    evaluation: Float[np.ndarray, " seed"] | None = None
    """Mean return of each seed's last evaluation."""
    reached: Reached | None = None
    """Given if `returns` has fewer rows than the training had."""

    @classmethod
    def of(cls, arm: Arm, found: Sequence[PoliciesResult]) -> "Scores":
        """Join the blocks of an arm, in the order of their seeds.

        Raises:
            PlanspaceError: two blocks have different numbers of steps, or contain the same seed.
        """
        found = sorted(found, key=lambda result: result.seeds[0])
        seeds = tuple(seed for result in found for seed in result.seeds)
        if len(set(seeds)) < len(seeds) or len({result.steps for result in found}) > 1:
            raise PlanspaceError(f"the blocks of {arm.name} do not fit together.")
        last = [result.eval_returns[-1] if result.eval_returns else [] for result in found]
        evaluation = np.array([np.nan if x is None else x for block in last for x in block], dtype=float)
        return cls(
            seeds,
            np.array(found[0].steps),
            np.concatenate([np.array(result.returns, dtype=float) for result in found], axis=1),
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


# --- one number a seed ----------------------------------------------------------------------------------


def final(scores: Scores) -> Float[np.ndarray, " seed"]:
    """Final return of each seed: its mean return over the last `FINAL_STEPS`."""
    if scores.reached is not None:
        return scores.reached.final
    return _mean_between(scores, 1.0 - min(FINAL_STEPS / scores.steps[-1], FINAL_SHARE), 1.0)


def early(scores: Scores) -> Float[np.ndarray, " seed"]:
    """Mean return of each seed over the first quarter of the training."""
    if scores.reached is not None:
        return scores.reached.early
    return _mean_between(scores, 0.0, EARLY_SHARE)


def whole(scores: Scores) -> Float[np.ndarray, " seed"]:
    """Mean return of each seed over the whole training: the area under its curve divided by the steps."""
    if scores.reached is not None:
        return scores.reached.whole
    return _mean_between(scores, 0.0, 1.0)


def steps_to(scores: Scores, threshold: float, window: int = 2) -> Float[np.ndarray, " seed"]:
    """Steps until the mean of `window` rows is first above a threshold; infinite for a seed that never is."""
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
    rows[0 if high < 1.0 else -1] = True  # of a training of a few rows, the first or the last
    weights = np.diff(scores.steps, prepend=0)[rows]
    return np.average(scores.returns[rows], axis=0, weights=weights)


# --- numbers over seeds ---------------------------------------------------------------------------------


def mean(x: Float[np.ndarray, "*batch seed"]) -> Float[np.ndarray, "*batch"]:
    """The mean."""
    return np.asarray(np.mean(x, axis=-1))


def iqm(x: Float[np.ndarray, "*batch seed"]) -> Float[np.ndarray, "*batch"]:
    """Interquartile mean: of the middle half of the seeds (Agarwal et al. 2021)."""
    return np.asarray(scipy.stats.trim_mean(x, 0.25, axis=-1))


def best(x: Float[np.ndarray, "*batch seed"]) -> Float[np.ndarray, "*batch"]:
    """Mean of the best seeds."""
    return np.asarray(np.sort(x, axis=-1)[..., -NUM_BEST:].mean(axis=-1))


def log_std(x: Float[np.ndarray, "*batch seed"]) -> Float[np.ndarray, "*batch"]:
    """Logarithm of the deviation over seeds; of one seed, or of seeds all alike, of a billionth."""
    return np.asarray(np.log(np.maximum(np.std(x, axis=-1, ddof=min(1, x.shape[-1] - 1)), 1e-9)))


def interval(
    scores: Scores, number: Callable[[np.ndarray], np.ndarray], x: Float[np.ndarray, " seed"]
) -> Interval:
    """95 % interval of a number over seeds."""
    drawn = _draws(scores.seeds, scores.num_embeddings)
    return _widened(float(number(x)), number(x[drawn]), len(x), scores.num_embeddings)


def iqm_over_tasks(samples: Sequence[Float[np.ndarray, " seed"]]) -> tuple[float, Interval]:
    """IQM over tasks and seeds together, seeds drawn within each task (the stratified bootstrap).

    Args:
        samples: the normalised scores of each task.
    """

    def number(*drawn: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.asarray(scipy.stats.trim_mean(np.concatenate(drawn, axis=axis), 0.25, axis=axis))

    found = scipy.stats.bootstrap(
        tuple(samples), number, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0)
    )
    low, high = found.confidence_interval
    return float(number(*samples)), (float(low), float(high))


def probability_of_improvement(
    arm: Float[np.ndarray, " seed"], other: Float[np.ndarray, " other_seed"]
) -> tuple[float, Interval]:
    """How often a seed of one arm is better than one of the other, ties counting half (Mann and Whitney)."""

    def number(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
        pairs = np.sign(a[..., :, None] - b[..., None, :])
        return np.asarray((1.0 + pairs.mean(axis=(-2, -1))) / 2.0)

    found = scipy.stats.bootstrap(
        (arm, other), number, n_resamples=1000, method="percentile", rng=np.random.default_rng(0)
    )
    low, high = found.confidence_interval
    return float(number(arm, other)), (float(low), float(high))


def profile(
    x: Float[np.ndarray, " seed"], thresholds: Float[np.ndarray, " threshold"]
) -> Float[np.ndarray, " threshold"]:
    """Performance profile: the share of seeds above each threshold."""
    return np.asarray((x[:, None] > thresholds).mean(axis=0))


def variance_components(scores: Scores, x: Float[np.ndarray, " seed"]) -> tuple[float, float] | None:
    """Deviation due to the embedding, and due to the policy's seed (one-way random effects).

    Returns:
        None where there are fewer than two embeddings or a policy each.
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
    """Logarithm of the deviation over seeds of `base` over that of `scores`, which have the same seeds."""
    return _compare("spread", scores, base)


# --- claims ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """What became of a claim."""

    number: float
    interval: Interval
    seeds: int
    """How many decided it."""
    verdict: str
    """holds, does not hold, or cannot tell."""


MIN_SEEDS = 5
"""Fewer decide nothing: what they do not differ in, a bootstrap does not see."""
HOLDS, FAILS, OPEN = "holds", "does not hold", "cannot tell"


def judge(claim: Claim, arm: Scores, other: Scores | None) -> Verdict:
    """Decides a claim; see `Claim`.

    Args:
        claim: the claim.
        arm: its arm.
        other: what it is compared with; of both, the seeds they share are taken.
    """
    shared = tuple(seed for seed in arm.seeds if other is None or seed in other.seeds)
    if len(shared) < MIN_SEEDS:
        return Verdict(np.nan, (np.nan, np.nan), len(shared), OPEN)
    other = None if other is None else other.of_seeds(shared)
    number, (low, high) = _compare(claim.measure, arm.of_seeds(shared), other)
    return Verdict(number, (low, high), len(shared), _verdict(claim, low, high))


def _compare(measure: Measure, arm: Scores, other: Scores | None) -> tuple[float, Interval]:
    """A measure of an arm less another's with the same seeds, and its interval; a spread turned about."""
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
    "spread": (final, log_std, -1),  # less spread is what is claimed
    "early_spread": (early, log_std, -1),
}
"""A number of each seed, what is made of them, and which way is up."""


@lru_cache(maxsize=64)
def _draws(seeds: tuple[int, ...], num_embeddings: int) -> Int[np.ndarray, "resample seed"]:
    """Which seeds each resample has: embeddings first, where there are several, then seeds of each."""
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
    """How many embeddings are drawn from: the smaller number, of two arms that both have several."""
    several = [x.num_embeddings for x in (arm, other) if x is not None and x.num_embeddings > 1]
    return min(several, default=0)


def _widened(number: float, draws: np.ndarray, num_seeds: int, num_embeddings: int) -> Interval:
    """Percentiles of the draws, as much farther from the number as few independent things ask for."""
    num = num_embeddings if num_embeddings > 1 else num_seeds
    tail = (1.0 - CONFIDENCE) / 2
    low, high = np.percentile(draws, [100 * tail, 100 * (1 - tail)])
    if num < 2:
        return float(low), float(high)
    student = float(scipy.stats.t.ppf(1 - tail, num - 1) / scipy.stats.norm.ppf(1 - tail))
    wider = student * np.sqrt(num / (num - 1))
    return float(number - wider * (number - low)), float(number + wider * (high - number))
