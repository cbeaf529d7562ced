"""Metrics of an embedding on demonstrations: how straight plans are in z. Read several metrics together.

An embedding that discards the state can be straight: all demonstrations of a problem share a goal, so the
time left as the only number of z would score well. The effective rank and the decoded error show this. Only
encoder means are used. `path_error` is the paper's (equations 10 and 11).
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Quaternion
from planspace.embed.rotations import find_quaternions, with_one_sign, with_signs_of
from planspace.errors import PlanspaceError
from planspace.physics.angles import wrap

MIN_STATES = 12
"""Demonstrations with fewer states are left out: too short to measure."""
MIDPOINT_SPACINGS = (5, 10, 30)
MAX_MIDPOINT_ERROR = 100.0
"""Bound of the midpoint error of a triplet. Above it, the path between the ends is over 200 times as long as
their distance: it comes back to where it was."""
MIN_STD_FRACTION, STD_ROWS = 0.01, 2000
"""A number's standard deviation counts as at least this fraction of that over the whole dataset, of which
about so many states are looked at."""
ACTIVE_FRACTION = 0.01
"""A dimension of z has collapsed if its variance is below this fraction of the mean over dimensions."""
SCALED = ("path_error", "path_error_std", "duration_error")
"""Metrics of a scale that is fitted to the demonstrations."""
CONFIDENCE, BOOTSTRAP_DRAWS = 0.95, 1000

Map = Callable[[np.ndarray], np.ndarray]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Geometry:
    """The metrics; the value for a perfectly straight plan at constant speed is in brackets.

    A metric is NaN if there is nothing to measure, and `missing` says why.
    """

    straightness: float
    """|z_T - z_0| divided by the length of the path in z, mean over demonstrations [1]."""
    speed_variation: float
    """Standard deviation of |dz| divided by its mean, mean over demonstrations [0]."""
    midpoint_error: float
    """Distance of z_t from the midpoint of its neighbours, divided by their distance [0]."""
    time_correlation: float
    """Spearman correlation of |z_t - z_T| with the time left, mean over demonstrations [1]."""
    path_error: float
    """The paper's: mean |C d - y|, d = |z_0 - z_T|, y the path length in raw states divided by its mean."""
    path_error_std: float
    """Standard deviation of |C d - y|."""
    duration_error: float
    """The same, where y is the duration divided by its mean [0]."""
    effective_rank: float
    """exp of the entropy of the normalised eigenvalues of cov(z): how many dimensions are in use."""
    active_dims: int
    """Number of dimensions of z that have not collapsed."""
    decoded_error: float
    """Root mean square error of the state decoded from z, in standard deviations of each number."""
    num_demos: int
    """Number of demonstrations measured."""

    def plain(self) -> dict[str, int | float | None]:
        """Return the metrics by name for JSON; None if there is nothing to measure."""
        return {name: None if np.isnan(value) else value for name, value in asdict(self).items()}

    def missing(self) -> dict[str, str]:
        """The reason for each metric, and for `intervals`, that there is nothing to measure."""
        one = "one demonstration: the scale C makes its error 0"
        same = one if self.num_demos == 1 else "no demonstration moves"
        reasons: dict[str, str] = {}
        reasons |= dict.fromkeys(SCALED, same)
        reasons |= dict.fromkeys(("speed_variation", "midpoint_error"), "z does not move")
        found = {name: reasons[name] for name, value in self.plain().items() if value is None}
        if self.num_demos == 1:
            found["intervals"] = "one demonstration has no spread"
        if self.num_demos == 2:
            found["intervals"] = "two demonstrations have one path error and one duration error"
        return found


class DemoMetrics(NamedTuple):
    """Measurements of each demonstration; `Geometry` summarises them."""

    straightness: Float[np.ndarray, " demo"]
    speed_variation: Float[np.ndarray, " demo"]
    midpoint_error: Float[np.ndarray, " demo"]
    time_correlation: Float[np.ndarray, " demo"]
    chord: Float[np.ndarray, " demo"]
    """|z_T - z_0|."""
    raw_length: Float[np.ndarray, " demo"]
    """Length of the path in raw states."""
    duration: Float[np.ndarray, " demo"]
    squared_error: Float[np.ndarray, " demo"]
    """Mean square error of the decoded states, over states and numbers."""
    moments: Float[np.ndarray, "demo z_1 z_1"]
    """Sum of (1, z)(1, z)^T over its states; cov(z) is computed from it."""


def measure(embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"]) -> Geometry:
    """Measure an embedding on some demonstrations.

    Raises:
        PlanspaceError: the demonstrations lack a state that it reads, or all are too short.
    """
    return summarise(tabulate(embedding, demos, episodes))


def tabulate(embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"]) -> DemoMetrics:
    """Measure an embedding on each demonstration; `bootstrap_intervals` needs this table."""
    demos = demos.select(embedding.inputs.names)
    quaternions = embedding.inputs.quaternions or find_quaternions(demos.info, demos.info.names)
    return measure_each(
        embedding.encode, lambda x: embedding.decode(embedding.encode(x)), demos, episodes, quaternions
    )


def measure_raw_state(
    demos: Demos, episodes: Int[np.ndarray, " demo"], train: Int[np.ndarray, " train_demo"]
) -> Geometry:
    """Measure the state itself, standardised by the training split, as a baseline."""
    reference = demos.states[demos.rows(train)]
    mean, std = reference.mean(axis=0), reference.std(axis=0)
    scale = np.where(std > 0, std, 1.0)
    return summarise(measure_each(lambda x: (x - mean) / scale, lambda x: x, demos, episodes))


def measure_constant(demos: Demos, episodes: Int[np.ndarray, " demo"]) -> Geometry:
    """Measure a constant z, as a baseline; its path and duration errors are those of a constant distance.

    The distance is d = 1, as in the 2020 figures, because d = 0 cannot be scaled to the mean of y.
    """
    quaternions = find_quaternions(demos.info, demos.info.names)
    mean_state = with_one_sign(demos.states[demos.rows(episodes)], quaternions).mean(axis=0)

    def decode(states: np.ndarray) -> np.ndarray:
        return np.tile(mean_state, (len(states), 1))

    table = measure_each(lambda x: np.zeros((len(x), 1)), decode, demos, episodes, quaternions)
    return summarise(table._replace(chord=np.ones_like(table.chord)))


def measure_each(
    encode: Map,
    decode: Map,
    demos: Demos,
    episodes: Int[np.ndarray, " demo"],
    quaternions: Sequence[Quaternion] = (),
) -> DemoMetrics:
    """Measure a map from states [T, n] to z [T, k] on each demonstration of at least `MIN_STATES` states.

    Args:
        encode: maps states to z.
        decode: maps states to their reconstruction from z.
        demos: the dataset.
        episodes: indices of the demonstrations to measure.
        quaternions: columns of the quaternions, whose signs make no difference to the decoded error.

    Raises:
        PlanspaceError: all demonstrations are too short.
    """
    measured = [demos.episode(int(i)) for i in episodes]
    measured = [e for e in measured if len(e.states) >= MIN_STATES]
    if not measured:
        raise PlanspaceError(f"no demonstration has the {MIN_STATES} states that measuring needs.")
    bounds = np.cumsum([len(e.states) for e in measured])[:-1]
    states = np.concatenate([e.states for e in measured])
    paths = np.split(encode(states).astype(float), bounds)
    errors = np.split(_squared_errors(demos, decode(states), states, quaternions), bounds)
    lifted = [np.concatenate([np.ones((len(z), 1)), z], axis=1) for z in paths]
    return DemoMetrics(
        straightness=np.array([_straightness(z) for z in paths]),
        speed_variation=np.array([_speed_variation(z) for z in paths]),
        midpoint_error=np.array([_midpoint_error(z) for z in paths]),
        time_correlation=np.array(
            [_time_correlation(z, e.times) for z, e in zip(paths, measured, strict=True)]
        ),
        chord=np.array([np.linalg.norm(z[-1] - z[0]) for z in paths]),
        raw_length=np.array([_steps(e.states).sum() for e in measured]),
        duration=np.array([e.times[-1] for e in measured]),
        squared_error=np.array([e.mean() for e in errors]),
        moments=np.stack([z.T @ z for z in lifted]),
    )


def summarise(table: DemoMetrics) -> Geometry:
    """Compute the metrics over all demonstrations of a table."""
    path_errors = _comparable(table.chord, table.raw_length)
    covariance = _covariance(table.moments.sum(axis=0))
    count = table.moments[:, 0, 0]
    return Geometry(
        straightness=float(table.straightness.mean()),
        speed_variation=_mean_of_known(table.speed_variation),
        midpoint_error=_mean_of_known(table.midpoint_error),
        time_correlation=float(table.time_correlation.mean()),
        path_error=float(path_errors.mean()),
        path_error_std=float(path_errors.std()),
        duration_error=float(_comparable(table.chord, table.duration).mean()),
        effective_rank=effective_rank(covariance),
        active_dims=int((np.diag(covariance) > ACTIVE_FRACTION * np.diag(covariance).mean()).sum()),
        decoded_error=float(np.sqrt(np.average(table.squared_error, weights=count))),
        num_demos=len(table.chord),
    )


def bootstrap_intervals(table: DemoMetrics, *, seed: int = 0) -> dict[str, Interval]:
    """Compute a 95 % percentile interval of each metric by drawing demonstrations with replacement.

    One demonstration has no intervals. A metric that cannot be measured has none either, nor have errors of
    `scaled_errors` of two demonstrations, which have one value.
    """
    rng, count = np.random.default_rng(seed), len(table.chord)
    if count < 2:
        return {}
    draws: list[dict[str, float]] = []
    for chosen in rng.integers(count, size=(BOOTSTRAP_DRAWS, count)):
        if (chosen == chosen[0]).all():  # one demonstration again and again
            chosen = chosen[:1]
        draws.append(asdict(summarise(DemoMetrics(*(column[chosen] for column in table)))))
    tail, found = (1 - CONFIDENCE) / 2, {}
    for name in (f.name for f in fields(Geometry) if f.name != "num_demos"):
        known = [draw[name] for draw in draws if not np.isnan(draw[name])]
        if known and not (count == 2 and name in SCALED):
            low, high = np.quantile(known, [tail, 1 - tail])
            found[name] = (float(low), float(high))
    return found


def paper_path_errors(
    embeddings: Sequence[Embedding], demos: Demos, episodes: Int[np.ndarray, " demo"]
) -> list[float]:
    """Compute only `path_error`, for embeddings that read the same states; fast enough for the log.

    It is NaN if fewer than two demonstrations are long enough.
    """
    demos = demos.select(embeddings[0].inputs.names)
    measured = episodes[np.diff(demos.offsets)[episodes] >= MIN_STATES]
    first, last = demos.offsets[measured], demos.offsets[measured + 1] - 1
    length = np.array([_steps(demos.episode(int(i)).states).sum() for i in measured])
    chords = [e.distance(demos.states[first], demos.states[last]) for e in embeddings]
    return [float(_comparable(chord, length).mean()) for chord in chords]


def scaled_errors(d: Float[np.ndarray, " demo"], y: Float[np.ndarray, " demo"]) -> np.ndarray:
    """|C d - y| with the best C, where y is divided by its mean (equations 10, 11); if d is 0, so is C."""
    y = y / y.mean()
    square = np.sum(d**2)
    scale = np.sum(d * y) / square if square > 0 else 0.0
    return np.abs(scale * d - y)


def _comparable(d: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`scaled_errors`, or NaN if there is nothing to compare: one demonstration, or none that moves."""
    return scaled_errors(d, y) if len(y) > 1 and y.any() else np.full(len(y), np.nan)


def _mean_of_known(values: np.ndarray) -> float:
    """The mean of the values that are known; NaN if none is."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else float("nan")


def effective_rank(covariance: Float[np.ndarray, "z z"]) -> float:
    """Exp of the entropy of the normalised eigenvalues (Roy and Vetterli 2007); 0 for no variance."""
    values = np.clip(np.linalg.eigvalsh(covariance), 0.0, None)
    if values.sum() == 0:
        return 0.0
    fractions = values / values.sum()
    fractions = fractions[fractions > 0]
    return float(np.exp(-np.sum(fractions * np.log(fractions))))


def _covariance(moments: np.ndarray) -> np.ndarray:
    """cov(z) from the sum of (1, z)(1, z)^T."""
    count, mean = moments[0, 0], moments[0, 1:] / moments[0, 0]
    return (moments[1:, 1:] - count * np.outer(mean, mean)) / max(count - 1, 1)


def _straightness(z: np.ndarray) -> float:
    length = _steps(z).sum()
    return float(np.linalg.norm(z[-1] - z[0]) / length) if length > 0 else 0.0


def _speed_variation(z: np.ndarray) -> float:
    speed = _steps(z)
    return float(speed.std() / speed.mean()) if speed.mean() > 0 else float("nan")


def _midpoint_error(z: np.ndarray) -> float:
    means = []
    for s in MIDPOINT_SPACINGS:
        if len(z) > 2 * s:
            a, t, b = z[: -2 * s], z[s:-s], z[2 * s :]
            error, gap = np.linalg.norm(t - (a + b) / 2, axis=1), np.linalg.norm(b - a, axis=1)
            moves = (error > 0) | (gap > 0)  # a triplet that stands still has no midpoint error
            bound = MAX_MIDPOINT_ERROR
            ratio = np.divide(error, gap, out=np.full(len(gap), bound), where=gap * bound > error)
            if moves.any():
                means.append(np.mean(ratio[moves]))
    return float(np.mean(means)) if means else float("nan")


def _time_correlation(z: np.ndarray, times: np.ndarray) -> float:
    distance = np.linalg.norm(z - z[-1], axis=1)
    if np.ptp(distance) == 0:
        return 0.0
    ranks = scipy.stats.rankdata(distance)  # the times are sorted, so their ranks are 0, 1, ...
    return float(-np.corrcoef(ranks, np.arange(len(times)))[0, 1])


def _steps(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(x, axis=0), axis=1)


def _squared_errors(
    demos: Demos, decoded: np.ndarray, states: np.ndarray, quaternions: Sequence[Quaternion]
) -> np.ndarray:
    """Mean square error of each decoded state over its numbers, in standard deviations of each number."""
    states = with_one_sign(states, quaternions)
    error = with_signs_of(decoded, states, quaternions) - states
    columns = list(demos.info.circular_columns)
    error[:, columns] = wrap(error[:, columns])
    sample = demos.states[:: max(1, len(demos.states) // STD_ROWS)]
    least = MIN_STD_FRACTION * with_one_sign(sample, quaternions).std(axis=0)
    std = np.maximum(states.std(axis=0), least)
    return np.mean((error / np.where(std > 0, std, 1.0)) ** 2, axis=1)
