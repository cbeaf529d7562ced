"""Continuous angles and even time steps for imported demonstrations.

Triplets are defined by numbers of steps, so all steps of a dataset should have the same length.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from planspace.demos.clean import take_rows
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from planspace.physics.angles import TWO_PI, unwrap_to_end
from planspace.physics.quaternion import conjugate, exp, log, multiply, normalise

UNEVEN = 1e-3
"""Relative difference below which steps count as even; float32 clocks differ by 2e-5."""
MAX_STATES, MAX_GROWTH = 1_000_000, 1000
"""Times are considered wrong if resampling gives more states than `MAX_STATES` and more than `MAX_GROWTH`
times as many as before."""
SAME_INSTANT = 1e-6
"""Times that differ by less than this fraction of a step are equal."""


def with_continuous_angles(episode: Episode, info: StateInfo, *, keep_windings: bool) -> Episode:
    """Unwrap angles, shift each to end in (-pi, pi], and keep the sign of quaternions continuous.

    Args:
        episode: the demonstration as recorded.
        info: the meaning of the states.
        keep_windings: do not shift angles.
    """
    states = episode.states.copy()
    for column in info.circular_columns:
        angle = _unwrap_if_wrapped(states[:, column])
        if not keep_windings and not -np.pi < angle[-1] <= np.pi:  # shifting by 0 could change the last bit
            angle = unwrap_to_end(angle)
        states[:, column] = angle
    for first in info.quaternion_columns:
        states[:, first : first + 4] = _one_sign(states[:, first : first + 4])
    return replace(episode, states=states)


def common_step(steps: Callable[[], Iterator[np.ndarray]], info: StateInfo) -> float | None:
    """The time step to resample to, or None if all steps already have the same length.

    The step is the median of all steps. If there is a model, it is rounded to a multiple of the time step of
    the model, so that controls can be replayed.

    Args:
        steps: returns the lengths of all steps [s], in parts. They are loaded at once only if they are not
            even.
        info: the meaning of the states, with the model.
    """
    all_steps = uneven_steps(steps)
    if all_steps is None:
        return None
    step = float(np.median(all_steps))
    if _even(all_steps, step):
        return None
    if info.source is not None:
        model_step = float(info.compile()[0].opt.timestep)
        step = max(1, round(step / model_step)) * model_step
    return step


def uneven_steps(steps: Callable[[], Iterator[np.ndarray]]) -> Float[np.ndarray, " step"] | None:
    """All steps [s], or None if they have the same length.

    Args:
        steps: returns the lengths of all steps [s], in parts.
    """
    extremes = np.array([(part.min(), part.max()) for part in steps() if len(part)])
    if len(extremes) == 0 or _even(extremes, extremes.min()):  # then any step represents all
        return None
    return np.concatenate(list(steps()))


def has_step(episode: Episode, step: float) -> bool:
    """Whether `resample` returns an episode unchanged."""
    return _num_steps(episode, step) == 0 or _even(np.diff(episode.times), step)


def resample(episode: Episode, info: StateInfo, step: float) -> Episode:
    """Resample an episode to a time step.

    The new times are counted back from the end, so that the last state, the goal, is kept. States are
    interpolated linearly (angles must be continuous), and rotations along the shortest rotation at constant
    speed. Each control is the one that is held when the step begins. An episode that already has this step,
    or is shorter than one step, is returned unchanged.

    Args:
        episode: the demonstration.
        info: the meaning of the states.
        step: the time step [s].
    """
    if has_step(episode, step):
        return episode
    times = np.arange(_num_steps(episode, step) + 1) * step
    instants = times + (float(episode.times[-1]) - times[-1])
    states = np.stack([np.interp(instants, episode.times, x) for x in episode.states.T], axis=1)
    for first in info.quaternion_columns:
        quaternion = slice(first, first + 4)
        states[:, quaternion] = _slerp(instants, episode.times, episode.states[:, quaternion])
    held = np.searchsorted(episode.times, instants[:-1] + SAME_INSTANT * step, side="right") - 1
    held = np.clip(held, 0, len(episode.controls) - 1)
    return replace(episode, states=states, controls=episode.controls[held], times=times)


def thinning_step(steps: Float[np.ndarray, " step"] | None, step: float, rate: float) -> float:
    """The time step of a rate.

    Args:
        steps: all recorded steps [s]; None if they have the same length.
        step: the recorded step if they have the same length [s].
        rate: the wanted number of states per second [Hz].

    Raises:
        UsageError: fewer states per second were recorded.
    """
    recorded = step if steps is None else float(np.median(steps))
    if 1 / rate < recorded * (1 - UNEVEN):
        raise UsageError(
            f"--rate {rate:g} asks for more states than were recorded, {1 / recorded:.4g} per second; give "
            "at most that, or leave it out."
        )
    return 1 / rate


def thin(episode: Episode, info: StateInfo, step: float) -> Episode:
    """Thin an episode to a time step: leave out states if its own steps divide it evenly, else resample.

    Args:
        episode: the demonstration.
        info: the meaning of the states.
        step: the time step [s].
    """
    steps = np.diff(episode.times)
    every = max(1, round(step / steps[0]))
    if every > 1 and _even(steps, step / every) and not has_step(episode, step):
        return take_rows(episode, np.arange(len(episode.times) - 1, -1, -every)[::-1])
    return resample(episode, info, step)


def _slerp(
    instants: Float[np.ndarray, " instant"],
    times: Float[np.ndarray, " time"],
    quaternions: Float[np.ndarray, "time 4"],
) -> Float[np.ndarray, "instant 4"]:
    """Rotations at some instants, at constant speed along the shortest rotation between neighbours."""
    before = np.clip(np.searchsorted(times, instants, side="right") - 1, 0, len(times) - 2)
    fraction = (instants - times[before]) / (times[before + 1] - times[before])
    start, end = normalise(quaternions[before]), normalise(quaternions[before + 1])
    turn = log(multiply(conjugate(start), end))
    found = normalise(multiply(start, exp(np.clip(fraction, 0.0, 1.0)[:, None] * turn)))
    return _one_sign(found * np.sign((found[:1] * start[:1]).sum()))


def _num_steps(episode: Episode, step: float) -> int:
    number = float(episode.times[-1]) / step
    if not number <= max(MAX_STATES, MAX_GROWTH * len(episode.times)):
        raise PlanspaceError(
            f"demonstration {episode.index} lasts {float(episode.times[-1]):.6g} s, which is {number:.3g} "
            f"steps of {step:.6g} s; correct its times, or keep them with --as-recorded."
        )
    return int(np.floor(number + SAME_INSTANT))


def _even(steps: np.ndarray, step: float) -> bool:
    return bool((np.abs(steps - step) <= UNEVEN * step).all())


def _one_sign(quaternions: Float[np.ndarray, "time 4"]) -> Float[np.ndarray, "time 4"]:
    """Choose between q and -q, which are the same rotation, so that there is no jump between neighbours."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return quaternions * np.cumprod(np.concatenate([[1.0], flips]))[:, None]


def _unwrap_if_wrapped(angle: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """Unwrap an angle that jumps by more than pi although all values lie within one full turn."""
    jumps = np.abs(np.diff(angle)).max(initial=0.0) > np.pi
    wrapped = jumps and np.ptp(angle) <= TWO_PI * (1 + 1e-6)
    return np.unwrap(angle) if wrapped else angle
