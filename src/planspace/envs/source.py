"""Reading an embedding's state from an environment: by name, from MuJoCo's data, or from the observation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from planspace.embed.embedding import Embedding
from planspace.envs.columns import Column, Environment, FlatColumns, read_columns
from planspace.errors import UsageError
from planspace.tasks.env_state import JointReader, joint_reader

StateSource = Callable[[Any, dict[str, Any]], np.ndarray]
"""(observation, info) to the embedding's states, with the leading axes of the observation."""


@dataclass(frozen=True)
class _Attribute:
    """Reads the environment's attribute `state`."""

    env: Any
    columns: list[int]

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        return np.asarray(self.env.state)[self.columns]


@dataclass(frozen=True)
class _Joints:
    """Reads positions, velocities and activations of a MuJoCo environment."""

    read: JointReader
    columns: list[int]

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        return self.read()[self.columns]


@dataclass(frozen=True)
class _Info:
    """Reads `info["state"]`."""

    columns: list[int]

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        if "state" not in info:
            raise UsageError(
                'the environments have `state_names`, but their info has no "state": add it in reset and '
                "step, or give columns=[...] of the observation."
            )
        return info["state"][..., self.columns]


def state_source(
    env: gymnasium.Env[Any, Any], embedding: Embedding, columns: Sequence[Column] | None
) -> StateSource:
    """Return what reads the embedding's state from a single environment.

    Args:
        env: the environment, wrapped or not.
        embedding: the embedding.
        columns: the columns of the observation that make the state, in the embedding's order; None reads
            the attributes `state` and `state_names`, or else the joints in MuJoCo's `model` and `data`.

    Raises:
        UsageError: the state cannot be read in any of these ways.
    """
    if columns is not None:
        return source_of_columns(env, env.observation_space, embedding, columns)
    inner: Any = env.unwrapped
    names = getattr(inner, "state_names", None)
    if names is not None:
        state = getattr(inner, "state", np.empty(0))
        if state is not None and np.size(state) != len(names):  # it is None before the first reset
            raise UsageError(
                f"the environment has {len(names)} `state_names`, but {np.size(state)} numbers in its "
                f"attribute `state`. {_columns_help(embedding)}"
            )
        return _Attribute(inner, _found(embedding, names, _units(inner, names)))
    if reader := joint_reader(env):
        return _Joints(reader, _found(embedding, reader.names, reader.units))
    raise UsageError(
        "the states cannot be read: the environment has neither attributes `state` and `state_names` nor "
        f"MuJoCo's `model` and `data`. {_columns_help(embedding)}"
    )


def vector_state_source(
    env: gymnasium.vector.VectorEnv[Any, Any, Any], embedding: Embedding, columns: Sequence[Column] | None
) -> StateSource:
    """Return what reads the embedding's states from a vector environment, all in one call.

    Args:
        env: the vector environment, wrapped or not.
        embedding: the embedding.
        columns: the columns of an observation that make the state, in the embedding's order; None reads
            `info["state"]`, whose names are in the attribute `state_names` of the environments.

    Raises:
        UsageError: the states cannot be read in either way.
    """
    if columns is not None:
        return source_of_columns(env, env.single_observation_space, embedding, columns)
    names = _names_of_vector(env.unwrapped)
    if names is None:
        raise UsageError(
            'the states cannot be read: the environments have no `state_names` for their info["state"]. '
            f"{_columns_help(embedding)} Or wrap each single environment in PlanSpaceObservation, which "
            "can also read MuJoCo's data."
        )
    return _Info(_found(embedding, names, _units(env.unwrapped, names)))


def source_of_columns(
    env: Environment, space: gymnasium.Space[Any], embedding: Embedding, columns: Sequence[Column]
) -> StateSource:
    """Return what reads states from columns of the observation.

    Args:
        env: the environment.
        space: the observation space of a single environment.
        embedding: the embedding.
        columns: the columns, as for `PlanSpaceObservation`.

    Raises:
        UsageError: the columns have the wrong number or cannot be read; see `read_columns`.
    """
    if isinstance(columns, str) or not isinstance(columns, Sequence | np.ndarray):
        raise UsageError(f"columns must be a list of numbers or names, got {columns!r}.")
    reader = read_columns(env, space, columns)
    if len(columns) != embedding.state_dim:
        raise UsageError(f"{_wanted(embedding)}, got {len(columns)} columns.")
    places = reader.columns if isinstance(reader, FlatColumns) else reader.places
    if twice := [column for i, column in enumerate(columns) if places[i] in places[:i]]:
        raise UsageError(f"columns {list(columns)} name {twice[0]!r} twice; {_wanted(embedding)}.")
    return reader


def _names_of_vector(inner: Any) -> Sequence[str] | None:
    if hasattr(inner, "state_names"):
        return inner.state_names
    try:
        return inner.get_attr("state_names")[0]
    except (AttributeError, KeyError, TypeError):
        return None


def _units(inner: Any, names: Sequence[str]) -> list[str]:
    """The units of a state's numbers: environments of planspace know them."""
    fields = getattr(inner, "state_fields", {})
    return [fields.get(name, "") for name in names] if isinstance(fields, dict) else []


def _found(embedding: Embedding, names: Sequence[str], units: Sequence[str]) -> list[int]:
    """Return where each number of the embedding's state is among these names."""
    try:
        return list(embedding.columns_of(names, units))
    except UsageError as error:
        raise UsageError(f"{error} {_columns_help(embedding)}") from None


def _columns_help(embedding: Embedding) -> str:
    return (
        f"Give columns=[...], the columns of the observation that hold ({_names(embedding)}): numbers, or "
        "names such as 'observation[0]' if it is a dictionary."
    )


def _wanted(embedding: Embedding) -> str:
    return f"the embedding reads {embedding.state_dim} numbers ({_names(embedding)})"


def _names(embedding: Embedding) -> str:
    return ", ".join(embedding.inputs.names)
