"""How straight is it? Metrics of an embedding on demonstrations, none of which may stand alone.

Straightness can be won by throwing state away (all demonstrations of a problem share a goal: a scalar time
to go would score well), so the effective rank and the decoded error stand beside it. Only encoder means are
used. Definitions: the design's geometry section; `path_error` is the paper's (equations 10 and 11).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.stats
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.errors import PlanspaceError
from planspace.physics.angles import wrap

MIN_STATES = 12
"""Shorter demonstrations have no geometry to speak of and are left out."""
MIDPOINT_SPACINGS = (5, 10, 30)
MIN_LENGTH = 1e-9
ACTIVE_VARIANCE = 0.01
"""A dimension of z whose mean varies less than this over states (the prior has 1) has collapsed."""

Encode = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Geometry:
    """The metrics; what each should be for a perfectly straight plan at constant speed is in brackets."""

    straightness: float
    """|z_T - z_0| over the length of the path in z, mean over demos [1]."""
    speed_variation: float
    """Deviation of |dz| over its mean, mean over demos [0]."""
    midpoint_error: float
    """How far z_t lies from the midpoint of its neighbours, over their distance [0]."""
    time_correlation: float
    """Spearman correlation of |z_t - z_T| with the time remaining, mean over demos [1]."""
    path_error: float
    """The paper's: mean |C d - y|, y the path length in raw states over its mean, d = |z_0 - z_T|."""
    path_error_std: float
    """Deviation of |C d - y|."""
    duration_error: float
    """The same with y the duration over its mean [0]."""
    effective_rank: float
    """exp of the entropy of the normalised eigenvalues of cov(z): how many dimensions are in use."""
    active_dims: int
    """Dimensions of z whose mean varies at all."""
    decoded_error: float
    """Root mean square error of the state decoded from z, each number over its deviation; NaN if none."""
    num_demos: int
    """How many demonstrations were measured."""


def measure(embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"]) -> Geometry:
    """Measures an embedding on some demonstrations.

    Raises:
        PlanspaceError: the demos have other states, or none is long enough.
    """
    if demos.info.names != embedding.inputs.names:
        raise PlanspaceError(
            f"the embedding reads the states ({', '.join(embedding.inputs.names)}), the demonstrations have "
            f"({', '.join(demos.info.names)})."
        )
    rows = demos.rows(episodes)
    decoded = embedding.decode(embedding.encode(demos.states[rows]))
    error = _state_error(demos, decoded, demos.states[rows])
    return measure_map(embedding.encode, demos, episodes, decoded_error=error)


def measure_raw_state(
    demos: Demos, episodes: Int[np.ndarray, " demo"], train: Int[np.ndarray, " train_demo"]
) -> Geometry:
    """The same metrics of the state itself, standardised by the training split: what to compare with."""
    reference = demos.states[demos.rows(train)]
    mean, deviation = reference.mean(axis=0), reference.std(axis=0)
    return measure_map(lambda x: (x - mean) / deviation, demos, episodes, decoded_error=0.0)


def measure_map(
    encode: Encode, demos: Demos, episodes: Int[np.ndarray, " demo"], *, decoded_error: float
) -> Geometry:
    """Measures any map from states [T, n] to z [T, k]."""
    measured = [demos.episode(int(i)) for i in episodes]
    measured = [e for e in measured if len(e.states) >= MIN_STATES]
    if not measured:
        raise PlanspaceError(f"no demonstration has the {MIN_STATES} states that measuring needs.")
    paths = [encode(e.states).astype(float) for e in measured]
    chord = np.array([np.linalg.norm(z[-1] - z[0]) for z in paths])
    raw_length = np.array([_steps(e.states).sum() for e in measured])
    duration = np.array([e.times[-1] for e in measured])
    path_errors, duration_errors = scaled_errors(chord, raw_length), scaled_errors(chord, duration)
    covariance = np.atleast_2d(np.cov(np.concatenate(paths).T))
    return Geometry(
        straightness=float(np.mean([_straightness(z) for z in paths])),
        speed_variation=float(np.mean([_speed_variation(z) for z in paths])),
        midpoint_error=float(np.mean([_midpoint_error(z) for z in paths])),
        time_correlation=float(
            np.mean([_time_correlation(z, e.times) for z, e in zip(paths, measured, strict=True)])
        ),
        path_error=float(path_errors.mean()),
        path_error_std=float(path_errors.std()),
        duration_error=float(duration_errors.mean()),
        effective_rank=effective_rank(covariance),
        active_dims=int((np.diag(covariance) > ACTIVE_VARIANCE).sum()),
        decoded_error=decoded_error,
        num_demos=len(measured),
    )


def scaled_errors(d: Float[np.ndarray, " demo"], y: Float[np.ndarray, " demo"]) -> np.ndarray:
    """|C d - y| for y over its mean and the best C (equations 10, 11); d of all zeros predicts 0."""
    y = y / y.mean()
    square = np.sum(d**2)
    scale = np.sum(d * y) / square if square > 0 else 0.0
    return np.abs(scale * d - y)


def effective_rank(covariance: Float[np.ndarray, "z z"]) -> float:
    """Exp of the entropy of the normalised eigenvalues (Roy and Vetterli 2007); 0 for no variance."""
    values = np.clip(np.linalg.eigvalsh(covariance), 0.0, None)
    if values.sum() == 0:
        return 0.0
    shares = values / values.sum()
    shares = shares[shares > 0]
    return float(np.exp(-np.sum(shares * np.log(shares))))


def _straightness(z: np.ndarray) -> float:
    length = _steps(z).sum()
    return float(np.linalg.norm(z[-1] - z[0]) / length) if length > 0 else 0.0


def _speed_variation(z: np.ndarray) -> float:
    speed = _steps(z)
    return float(speed.std() / speed.mean()) if speed.mean() > 0 else 0.0


def _midpoint_error(z: np.ndarray) -> float:
    means = []
    for s in MIDPOINT_SPACINGS:
        if len(z) > 2 * s:
            a, t, b = z[: -2 * s], z[s:-s], z[2 * s :]
            gap = np.maximum(np.linalg.norm(b - a, axis=1), MIN_LENGTH)
            means.append(np.mean(np.linalg.norm(t - (a + b) / 2, axis=1) / gap))
    return float(np.mean(means))


def _time_correlation(z: np.ndarray, times: np.ndarray) -> float:
    distance = np.linalg.norm(z - z[-1], axis=1)
    if np.ptp(distance) == 0:
        return 0.0
    return float(scipy.stats.spearmanr(distance, times[-1] - times).statistic)


def _steps(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(x, axis=0), axis=1)


def _state_error(demos: Demos, decoded: np.ndarray, states: np.ndarray) -> float:
    error = decoded - states
    columns = list(demos.info.circular_columns)
    error[:, columns] = wrap(error[:, columns])
    return float(np.sqrt(np.mean((error / states.std(axis=0)) ** 2)))
