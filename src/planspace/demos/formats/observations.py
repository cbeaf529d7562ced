"""Choose the numbers of an observation that are the state."""

import re
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError, unknown

OBSERVATION_KEY = "observation"
"""Entry of a dictionary observation that is the state, as in goal environments."""


def choose_states(
    observations: Any, info: StateInfo | None, options: ImportOptions, where: str
) -> Float[np.ndarray, "time state"]:
    """Extract the states from observations.

    Args:
        observations: an array, or a dictionary of arrays, with one row per state.
        info: the states; None if they are unknown.
        options: `states` maps the name of a state to its place: `3`, `key[3]` or `key`. If it is empty, the
            whole observation is the state.
        where: the episode, for messages.

    Raises:
        UsageError: `options.states` does not fit the observations, or is needed and empty.
        PlanspaceError: an observation is not a vector of numbers.
    """
    keyed = isinstance(observations, dict)
    main = observations.get(OBSERVATION_KEY) if keyed else observations
    if options.states:
        names = info.names if info else tuple(options.states)
        for name in options.states:
            if name not in names:
                raise unknown("state", name, names)
        for name in names:
            if name not in options.states:
                raise UsageError(f"--state must name all states; {name!r} is missing.")
        picked = [_pick(observations, main, options.states[name], where) for name in names]
        return np.stack(picked, axis=1)
    if main is None:
        keys = ", ".join(sorted(observations))
        raise UsageError(
            f"the observations of {where} are a dictionary with the keys {keys}; choose the states with "
            "--state NAME=KEY[INDEX]."
        )
    states = flat(main, f"the observations of {where}")
    if info is not None and states.shape[1] != len(info.names):
        raise UsageError(
            f"the observations of {where} have {states.shape[1]} numbers, but a state of the problem has "
            f"{len(info.names)} ({', '.join(info.names)}); choose them with --state NAME=INDEX."
        )
    return states


def flat(values: Any, what: str) -> Float[np.ndarray, "time number"]:
    """Convert values to floats with one row per step; single numbers become rows of length one.

    Args:
        values: one number or vector per step.
        what: the values, for messages.

    Raises:
        PlanspaceError: the values are not vectors of numbers, but images or dictionaries, for example.
    """
    array = None if isinstance(values, dict | tuple) else np.asarray(values)
    if array is None or array.dtype.kind not in "biuf" or array.ndim not in (1, 2):
        kind = type(values).__name__ if array is None else f"{array.dtype} of shape {array.shape[1:]}"
        raise PlanspaceError(f"{what} must be vectors of numbers, got {kind}.")
    return array.reshape(len(array), -1).astype(float)


def _pick(observations: Any, main: Any, place: str, where: str) -> Float[np.ndarray, " time"]:
    """One number of each observation, at a place written as `3`, `key[3]` or `key`."""
    match = re.fullmatch(r"(?:(?P<key>.+)\[)?(?P<index>\d{1,9})(?(key)\])", place)
    key = match["key"] if match else place
    if key is None:
        source = main
    elif isinstance(observations, dict) and key in observations:
        source = observations[key]
    else:
        keys = ", ".join(sorted(observations)) if isinstance(observations, dict) else "none"
        raise UsageError(f"the observations of {where} have no key {key!r}; the keys are: {keys}.")
    if source is None:
        raise UsageError(
            f"--state ...={place}: the observations of {where} are a dictionary, so give KEY[INDEX]."
        )
    values = flat(source, f"the observations of {where}")
    index = int(match["index"]) if match else 0
    if index >= values.shape[1] or (match is None and values.shape[1] != 1):
        raise UsageError(
            f"--state ...={place} does not fit {where}, which has {values.shape[1]} numbers there: "
            f"give an index from 0 to {values.shape[1] - 1}."
        )
    return values[:, index]
