"""Continuous angles and even time steps: what every imported demonstration is brought to.

Triplets are cut in steps, so a step should last as long everywhere in a dataset.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError
from planspace.physics.angles import TWO_PI, unwrap_to_end
from planspace.physics.quaternion import normalise

UNEVEN = 1e-3
"""Steps that differ by less than this share of themselves are even: float32 clocks differ by 2e-5."""
MOST_STATES, MOST_TIMES = 1_000_000, 1000
"""A demonstration that would get more states than this, and so many times what it has, has wrong times."""
SAME_INSTANT = 1e-6
"""Two times closer than this share of a step are one."""


def with_continuous_angles(episode: Episode, info: StateInfo, *, keep_windings: bool) -> Episode:
    """Joins the angles a file wrapped, and shifts each to end in (-pi, pi]; quaternions keep their sign.

    Args:
        episode: as its file has it.
        info: says which columns are circular, and which are quaternions.
        keep_windings: leave continuous angles where they are.
    """
    states = episode.states.copy()
    for column in info.circular_columns:
        angle = _joined(states[:, column])
        if not keep_windings and not -np.pi < angle[-1] <= np.pi:  # shifting by 0 would cost the last bit
            angle = unwrap_to_end(angle)
        states[:, column] = angle
    for first in info.quaternion_columns:
        states[:, first : first + 4] = _one_sign(states[:, first : first + 4])
    return replace(episode, states=states)


def common_step(steps: Callable[[], Iterator[np.ndarray]], info: StateInfo) -> float | None:
    """The step a dataset is to have, or None if all its steps are as long as each other.

    It is the median of all steps; where there is a model, the nearest whole number (at least 1) of its time
    steps, so that controls can be replayed.

    Args:
        steps: gives the lengths of all steps [s], in parts; all at once they are in memory only where they
            are not even.
        info: says which model.
    """
    extremes = np.array([(part.min(), part.max()) for part in steps() if len(part)])
    if len(extremes) == 0 or _even(extremes, extremes.min()):  # and so from any of them
        return None
    every = np.concatenate(list(steps()))
    step = float(np.median(every))
    if _even(every, step):
        return None
    if info.mjcf:
        model_step = float(info.compile()[0].opt.timestep)
        step = max(1, round(step / model_step)) * model_step
    return step


def has_step(episode: Episode, step: float) -> bool:
    """Whether an episode comes back from `resample` as it is."""
    return _num_steps(episode, step) == 0 or _even(np.diff(episode.times), step)


def resample(episode: Episode, info: StateInfo, step: float) -> Episode:
    """Brings an episode to a time step; it comes back as it is if it has that step already.

    The new times are counted back from the end, because a demonstration's end, its goal, matters more than
    a fraction of a step at its start. States are interpolated linearly (angles must be continuous;
    quaternions are brought back to length one); a control is the one in force when the step begins. An
    episode shorter than one step stays as it is.
    """
    if has_step(episode, step):
        return episode
    times = np.arange(_num_steps(episode, step) + 1) * step
    instants = times + (float(episode.times[-1]) - times[-1])
    states = np.stack([np.interp(instants, episode.times, x) for x in episode.states.T], axis=1)
    for first in info.quaternion_columns:
        states[:, first : first + 4] = normalise(states[:, first : first + 4])
    in_force = np.searchsorted(episode.times, instants[:-1] + SAME_INSTANT * step, side="right") - 1
    in_force = np.clip(in_force, 0, len(episode.controls) - 1)
    return replace(episode, states=states, controls=episode.controls[in_force], times=times)


def _num_steps(episode: Episode, step: float) -> int:
    number = float(episode.times[-1]) / step
    if not number <= max(MOST_STATES, MOST_TIMES * len(episode.times)):
        raise PlanspaceError(
            f"demonstration {episode.index} lasts {float(episode.times[-1]):.6g} s, {number:.3g} steps of "
            f"the {step:.6g} s that all are to have; correct its times, or keep them by --as-recorded."
        )
    return int(np.floor(number + SAME_INSTANT))


def _even(steps: np.ndarray, step: float) -> bool:
    return bool((np.abs(steps - step) <= UNEVEN * step).all())


def _one_sign(quaternions: Float[np.ndarray, "time 4"]) -> Float[np.ndarray, "time 4"]:
    """Q and -q are one rotation; between neighbours of unlike sign there would be a jump."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return quaternions * np.cumprod(np.concatenate([[1.0], flips]))[:, None]


def _joined(angle: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """A file wrapped its angle if it jumps by more than half a turn and yet never leaves one turn."""
    jumps = np.abs(np.diff(angle)).max(initial=0.0) > np.pi
    wrapped = jumps and np.ptp(angle) <= TWO_PI * (1 + 1e-6)
    return np.unwrap(angle) if wrapped else angle
