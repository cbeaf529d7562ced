"""Columns of an observation, given by number or by the names that the importer uses, `observation[0]`."""

import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, flatdim
from gymnasium.wrappers import FlattenObservation
from gymnasium.wrappers.vector import FlattenObservation as VectorFlattenObservation

from planspace.errors import UsageError, quoted

Column = int | str
"""A number, or `key[3]`, `key` (an entry with one number) or `3`."""
Environment = gymnasium.Env[Any, Any] | gymnasium.vector.VectorEnv[Any, Any, Any]
Entries: TypeAlias = Mapping[str, gymnasium.Space[Any]]
"""The entries of a dictionary space."""
MAIN_KEY = "observation"
"""The entry of a dictionary to which a number without a key refers, as in `demos import`."""
PATTERN = re.compile(r"(?:(?P<key>.+)\[)?(?P<index>\d{1,9})(?(key)\])")


@dataclass(frozen=True)
class FlatColumns:
    """Reads columns of a flat observation."""

    columns: list[int]

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        """Return the columns, with the leading axes of the observation."""
        return obs[..., self.columns]


@dataclass(frozen=True)
class DictColumns:
    """Reads columns of the entries of a dictionary observation."""

    places: list[tuple[str, int]]
    """Key and index of each column."""

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        """Return the columns, with the leading axes of the observation."""
        return np.stack([obs[key][..., index] for key, index in self.places], axis=-1)


def read_columns(
    env: Environment, space: gymnasium.Space[Any], columns: Sequence[Column]
) -> FlatColumns | DictColumns:
    """Return what reads columns of an observation.

    Args:
        env: the environment; if a `FlattenObservation` in it flattened a dictionary, names work, too.
        space: the observation space of a single environment.
        columns: the columns. A name is `key[3]`, `key` or `3`. In a dictionary, a number refers to its entry
            `observation`.

    Raises:
        UsageError: the observation is neither a flat `Box` nor a `Dict`, or has no such column.
    """
    if isinstance(space, Dict):
        return DictColumns([_place(space.spaces, column) for column in columns])
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise UsageError(f"columns need a flat Box or a Dict, and the observation space is {space}.")
    original = _flattened(env)
    found = [_flat_column(space.shape[0], original, column) for column in columns]
    if outside := [c for c in found if not 0 <= c < space.shape[0]]:
        raise UsageError(
            f"columns {list(columns)} reach outside an observation of {space.shape[0]} numbers: "
            f"{outside[0]} is not between 0 and {space.shape[0] - 1}."
        )
    if original is not None and all(_is_index(column) for column in columns):
        _refuse_other_entries(original, found)
    return FlatColumns(found)


def chain(env: Any) -> Iterator[Any]:
    """Yield an environment and everything that it wraps, from the outside to the inside.

    A vector environment in this process is followed by its first single environment.
    """
    while env is not None:
        yield env
        inner = getattr(env, "envs", None)  # of a SyncVectorEnv
        if isinstance(env, gymnasium.Wrapper | gymnasium.vector.VectorWrapper):
            env = env.env
        else:
            env = inner[0] if isinstance(inner, list | tuple) and inner else None


def _place(entries: Entries, column: Column) -> tuple[str, int]:
    """The key and the index of a column of a dictionary."""
    keys = ", ".join(entries)
    if isinstance(column, str):
        match = PATTERN.fullmatch(column)
        key, index = (match["key"], int(match["index"])) if match else (column, None)
    else:
        key, index = None, _index(column)
    if key is None:
        key = MAIN_KEY
        if key not in entries:
            raise UsageError(
                f"column {column!r} needs a key, because the observation has no entry {MAIN_KEY!r}: write "
                f"'KEY[{index}]' with one of the keys {keys}."
            )
    if key not in entries:
        raise UsageError(f"column {quoted(column)}: the observation has no key {key!r}; its keys are {keys}.")
    entry = entries[key]
    if not isinstance(entry, Box) or len(entry.shape) != 1:
        raise UsageError(f"column {quoted(column)}: the entry {key!r} is not a flat Box, but {entry}.")
    size = entry.shape[0]
    if index is None and size == 1:
        index = 0
    if index is None or not 0 <= index < size:
        raise UsageError(
            f"column {quoted(column)}: the entry {key!r} has {size} numbers; write '{key}[0]' to "
            f"'{key}[{size - 1}]'."
        )
    return key, index


def _flat_column(size: int, original: Entries | None, column: Column) -> int:
    """The index of a column in a flat observation, which may be a flattened dictionary."""
    if not isinstance(column, str):
        return _index(column)
    if _is_index(column):
        return int(column)
    if original is None:
        raise UsageError(
            f"column {quoted(column)} is a name, but the observation is a flat Box of {size} numbers without "
            "keys: give the numbers of the columns."
        )
    key, index = _place(original, column)
    return _offsets(original)[key] + index


def _is_index(column: Column) -> bool:
    return not isinstance(column, str) or column.isdecimal()


def _index(column: Any) -> int:
    try:
        if isinstance(column, bool):
            raise TypeError
        return operator.index(column)
    except TypeError:
        raise UsageError(
            f"columns must be whole numbers, or names such as 'observation[0]', got {column!r}."
        ) from None


def _offsets(entries: Entries) -> dict[str, int]:
    """Where each entry of a dictionary starts after flattening: Gymnasium keeps the order of the space."""
    sizes = [flatdim(entry) for entry in entries.values()]
    return dict(zip(entries, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))


def _flattened(env: Environment) -> Entries | None:
    """The entries of the dictionary that `FlattenObservation` flattened; None if the space changed later."""
    outer: Any = _space(env)
    for inner in chain(env):
        if _space(inner) != outer:
            return None
        if isinstance(inner, FlattenObservation | VectorFlattenObservation):
            space = _space(inner.env)
            return space.spaces if isinstance(space, Dict) else None
    return None


def _space(env: Any) -> gymnasium.Space[Any]:
    """The observation space of a single environment."""
    is_vector = isinstance(env, gymnasium.vector.VectorEnv)
    return env.single_observation_space if is_vector else env.observation_space


def _refuse_other_entries(entries: Entries, columns: list[int]) -> None:
    """Refuse numbers that miss `observation` in a flattened dictionary, where Gymnasium sorts the keys."""
    if MAIN_KEY not in entries:
        return
    start = _offsets(entries)[MAIN_KEY]
    stop = start + flatdim(entries[MAIN_KEY])
    if all(start <= c < stop for c in columns):
        return
    names = [f"{key}[{i}]" for key, entry in entries.items() for i in range(flatdim(entry))]
    read = ", ".join(names[c] for c in columns)
    raise UsageError(
        f"columns {columns} of the flattened observation are {read}, because FlattenObservation orders the "
        f"keys as {', '.join(entries)}. Give columns by name: '{MAIN_KEY}[0]' is column {start}, and the "
        "names listed here read the same numbers as before."
    )
