"""The names of observation and reward types; imports almost nothing, so that `--help` answers at once."""

from typing import Literal, TypeVar, get_args

from planspace.errors import unknown

Name = TypeVar("Name", bound=str)

RewardType = Literal["dense", "sparse", "2020"]
"""`dense`: the task's reward; `sparse`: 1 at the goal and 0 elsewhere; `2020`: the reward of the 2020 code,
with its mistakes and without limits on the controls, for tasks that have one."""

ObservationType = Literal["raw", "wrapped", "trig"]
"""`raw`: the task's observation, angles as they are; `wrapped`: the same with the angles of unlimited hinges
mapped to (-pi, pi]; `trig`: raw plus the sine and cosine of the task's angles."""
OBSERVATION_TYPES: tuple[ObservationType, ...] = get_args(ObservationType)
MAX_OBS = 100_000
"""Largest number of numbers in an observation."""


def find_observation_type(name: str) -> ObservationType:
    """Return the observation type with this name.

    Raises:
        UsageError: no observation type has this name.
    """
    return find_name("observation type", name, OBSERVATION_TYPES)


def find_name(what: str, name: str, known: tuple[Name, ...]) -> Name:
    """Return the member of a closed list of names, so that the type checker knows it is one.

    Raises:
        UsageError: the name is not in the list; the message suggests the nearest one.
    """
    for one in known:
        if one == name:
            return one
    raise unknown(what, name, known)
