"""Which numbers of an environment's observations are the state."""

import re
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import StateInfo
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError, UsageError, unknown

OBSERVATION_KEY = "observation"
"""The part of a dictionary that is the state, as in goal environments."""


def choose_states(
    observations: Any, info: StateInfo | None, options: ImportOptions, where: str
) -> Float[np.ndarray, "time state"]:
    """The numbers of each observation that make the state.

    Args:
        observations: an array, or a dictionary of arrays, with a row for each state.
        info: the states, where they are known.
        options: `states` maps a name to `3`, `key[3]` or `key`; without it all of the observation is taken.
        where: the episode, for messages.

    Raises:
        UsageError: the choice does not fit, or one is needed and was not made.
        PlanspaceError: the observation is no vector of numbers.
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
                raise UsageError(f"--state names some of the states, but not {name!r}.")
        picked = [_pick(observations, main, options.states[name], where) for name in names]
        return np.stack(picked, axis=1)
    if main is None:
        keys = ", ".join(sorted(observations))
        raise UsageError(
            f"the observations of {where} are a dictionary of {keys}; choose with --state NAME=KEY[INDEX]."
        )
    states = flat(main, f"the observations of {where}")
    if info is not None and states.shape[1] != len(info.names):
        raise UsageError(
            f"the observations of {where} have {states.shape[1]} numbers, a state of the problem has "
            f"{len(info.names)} ({', '.join(info.names)}); choose with --state NAME=INDEX."
        )
    return states


def flat(values: Any, what: str) -> Float[np.ndarray, "time number"]:
    """Numbers of one step in a row; a single number becomes a row of one.

    Raises:
        PlanspaceError: they are something else, such as a picture or a dictionary (`what` names them).
    """
    array = None if isinstance(values, dict | tuple) else np.asarray(values)
    if array is None or array.dtype.kind not in "biuf" or array.ndim not in (1, 2):
        kind = type(values).__name__ if array is None else f"{array.dtype} of shape {array.shape[1:]}"
        raise PlanspaceError(f"{what} are a {kind} each; planspace reads vectors of numbers.")
    return array.reshape(len(array), -1).astype(float)


def _pick(observations: Any, main: Any, place: str, where: str) -> Float[np.ndarray, " time"]:
    """One number of each observation; its place is `3`, `key[3]` or `key`."""
    match = re.fullmatch(r"(?:(?P<key>.+)\[)?(?P<index>\d{1,9})(?(key)\])", place)
    key = match["key"] if match else place
    if key is None:
        source = main
    elif isinstance(observations, dict) and key in observations:
        source = observations[key]
    else:
        keys = ", ".join(sorted(observations)) if isinstance(observations, dict) else "none"
        raise UsageError(f"the observations of {where} have no key {key!r}; keys: {keys}.")
    if source is None:
        raise UsageError(f"--state {place}: the observations of {where} need a KEY[INDEX].")
    values = flat(source, f"the observations of {where}")
    index = int(match["index"]) if match else 0
    if index >= values.shape[1] or (match is None and values.shape[1] != 1):
        raise UsageError(
            f"--state ...={place} does not fit {where}, where it has {values.shape[1]} numbers: "
            f"an index from 0 to {values.shape[1] - 1} is needed."
        )
    return values[:, index]
