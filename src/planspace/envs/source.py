"""Where an embedding's states come from: the environment by name, its MuJoCo data, or the observation."""

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from planspace.embed.embedding import Embedding
from planspace.errors import UsageError

StateSource = Callable[[Any, dict[str, Any]], np.ndarray]
"""(observation, info) to the states the embedding reads, after any leading axis of episodes."""


@dataclass(frozen=True)
class _Columns:
    """Numbers of a flat observation."""

    columns: list[int]

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        return obs[..., self.columns]


@dataclass(frozen=True)
class _Attribute:
    """Numbers of the environment's attribute `state`."""

    env: Any
    columns: list[int]

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        return np.asarray(self.env.state)[self.columns]


@dataclass(frozen=True)
class _Joints:
    """Positions and velocities of a MuJoCo environment's joints."""

    env: Any
    space: Any
    """A `StateSpace`."""
    columns: list[int]

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        return self.space.read(self.env.data.qpos, self.env.data.qvel)[self.columns]


@dataclass(frozen=True)
class _Info:
    """Numbers of `info["state"]`."""

    columns: list[int]

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        if "state" not in info:
            raise UsageError(
                'the environments have `state_names`, but gave no info["state"]; give it in reset and step, '
                "or say columns=[...] of the observation."
            )
        return info["state"][..., self.columns]


def state_source(
    env: gymnasium.Env[Any, Any], embedding: Embedding, columns: Sequence[int] | None
) -> StateSource:
    """How to read the embedding's states off a single environment.

    Args:
        env: the environment, which may be wrapped.
        embedding: what reads the states.
        columns: the numbers of the observation that are the states, in the embedding's order; None looks for
            attributes `state` and `state_names`, then for MuJoCo's `model` and `data` with joints of those
            names.

    Raises:
        UsageError: the states cannot be read in any of these ways.
    """
    if columns is not None:
        return source_of_columns(env.observation_space, embedding, columns)
    inner: Any = env.unwrapped
    names = getattr(inner, "state_names", None)
    if names is not None:
        state = getattr(inner, "state", np.empty(0))
        if state is not None and np.size(state) != len(names):  # None: there is none before the first reset
            raise UsageError(
                f"the environment has {len(names)} `state_names`, and {np.size(state)} numbers in its "
                f"attribute `state`. {_columns_help(embedding)}"
            )
        return _Attribute(inner, _found(embedding, names))
    if type(getattr(inner, "model", None)).__name__ == "MjModel":
        return _of_mujoco(inner, embedding)
    raise UsageError(
        "the states cannot be read: the environment has neither attributes `state` and `state_names` nor "
        f"MuJoCo's `model` and `data`. {_columns_help(embedding)}"
    )


def vector_state_source(
    env: gymnasium.vector.VectorEnv[Any, Any, Any], embedding: Embedding, columns: Sequence[int] | None
) -> StateSource:
    """How to read the embedding's states off a vector environment, all episodes at once.

    Args:
        env: the vector environment, which may be wrapped.
        embedding: what reads the states.
        columns: the numbers of an observation that are the states, in the embedding's order; None takes
            `info["state"]`, in the order of the attribute `state_names` of the environments.

    Raises:
        UsageError: the states cannot be read in either way.
    """
    if columns is not None:
        return source_of_columns(env.single_observation_space, embedding, columns)
    names = _names_of_vector(env.unwrapped)
    if names is None:
        raise UsageError(
            'the states cannot be read: the environments have no `state_names` for their info["state"]. '
            f"{_columns_help(embedding)} Or put PlanSpaceObservation around each single environment, which "
            "reads MuJoCo's data, too."
        )
    return _Info(_found(embedding, names))


def source_of_columns(
    space: gymnasium.Space[Any], embedding: Embedding, columns: Sequence[int]
) -> StateSource:
    """Reads states off the columns of a flat observation.

    Raises:
        UsageError: the observation is not flat, or the columns are not as many as are read, or outside.
    """
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise UsageError(f"columns are those of a flat Box, the observation is {space}.")
    try:
        columns = [operator.index(c) for c in columns if not isinstance(c, bool)]
    except TypeError:
        raise UsageError(f"columns are whole numbers, got {columns!r}.") from None
    if len(columns) != embedding.state_dim:
        raise UsageError(f"{_wanted(embedding)}, got {len(columns)} columns.")
    if not all(0 <= c < space.shape[0] for c in columns):
        raise UsageError(f"columns {list(columns)} reach outside an observation of {space.shape[0]} numbers.")
    return _Columns(columns)


def _of_mujoco(inner: Any, embedding: Embedding) -> StateSource:
    from planspace.physics.space import StateSpace  # brings MuJoCo with it, which such an environment has

    model = inner.model
    joints = [model.joint(i).name for i in range(model.njnt) if model.joint(i).name]
    space = StateSpace.from_model(model, joints)
    return _Joints(inner, space, _found(embedding, space.names))


def _names_of_vector(inner: Any) -> Sequence[str] | None:
    if hasattr(inner, "state_names"):
        return inner.state_names
    try:
        return inner.get_attr("state_names")[0]
    except (AttributeError, KeyError, TypeError):
        return None


def _found(embedding: Embedding, names: Sequence[str]) -> list[int]:
    """Where the embedding's states are among these."""
    try:
        return list(embedding.columns_of(names))
    except UsageError as error:
        raise UsageError(f"{error} {_columns_help(embedding)}") from None


def _columns_help(embedding: Embedding) -> str:
    return f"Give columns=[...], the numbers of the observation that are ({_names(embedding)})."


def _wanted(embedding: Embedding) -> str:
    return f"the embedding reads {embedding.state_dim} numbers ({_names(embedding)})"


def _names(embedding: Embedding) -> str:
    return ", ".join(embedding.inputs.names)
