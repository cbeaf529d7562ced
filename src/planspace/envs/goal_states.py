"""Goals as states that an embedding can encode: some numbers are in the observation, the others constant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Dict

from planspace.embed.embedding import Embedding
from planspace.envs.columns import DictColumns, Environment, FlatColumns, read_columns
from planspace.errors import UsageError, quoted

ACHIEVED, DESIRED = "achieved_goal", "desired_goal"
GOAL_KEYS = (ACHIEVED, DESIRED)
Goal = Mapping[str, float | str] | Sequence[float | str]
"""A state: for each name a number, or its place in the observation, such as `desired_goal[0]`."""


@dataclass(frozen=True)
class GoalStates:
    """Reads the states of goals from observations."""

    read: FlatColumns | DictColumns
    where: list[int]
    """Columns of the state that are read; the others are constant."""
    constants: np.ndarray
    """A state; the numbers that are read do not matter."""

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        """Return the states, with the leading axes of the observation."""
        numbers = self.read(obs, info)
        states = np.broadcast_to(self.constants, (*numbers.shape[:-1], len(self.constants))).copy()
        states[..., self.where] = numbers
        return states

    @property
    def keys(self) -> set[str]:
        """The entries of a dictionary observation that are read."""
        return {key for key, _ in self.read.places} if isinstance(self.read, DictColumns) else set()


def goal_states(
    env: Environment, space: gymnasium.Space[Any], embedding: Embedding, goal: Goal
) -> np.ndarray | GoalStates:
    """Return the goal as a state, or what reads it from observations if it has places in them.

    Args:
        env: the environment.
        space: the observation space of a single environment.
        embedding: the embedding.
        goal: the goal.

    Raises:
        UsageError: a number of the embedding's state is missing, is not finite, or has no such place.
    """
    values = _in_order(embedding, goal)
    places = [i for i, value in enumerate(values) if isinstance(value, str)]
    constants = [0.0 if i in places else value for i, value in enumerate(values)]
    names = ", ".join(embedding.inputs.names)
    if len(values) != embedding.state_dim or not all(
        isinstance(value, Real) and np.isfinite(float(value)) for value in constants
    ):
        raise UsageError(
            f"the goal must be a state of {embedding.state_dim} finite numbers ({names}), got "
            f"{quoted(goal)}; 'desired_goal[0]', for example, reads a number from the observation."
        )
    state = np.asarray(constants, dtype=float)
    if not places:
        return state
    return GoalStates(read_columns(env, space, [str(values[i]) for i in places]), places, state)


def observed_goals(
    env: Environment, space: gymnasium.Space[Any], embedding: Embedding, goal: Goal
) -> tuple[GoalStates, GoalStates]:
    """Return what reads the achieved and the desired goal of a goal environment as states.

    Args:
        env: the environment.
        space: the observation space of a single environment.
        embedding: the embedding.
        goal: the desired goal. The achieved one is read from the same places of `achieved_goal`.

    Raises:
        UsageError: the environment has no goals, or the goal is not read from `desired_goal`.
    """
    if not isinstance(space, Dict) or not set(GOAL_KEYS) <= set(space.spaces):
        raise UsageError(
            "z of goals needs a Dict observation with the keys achieved_goal and desired_goal, and the "
            f"observation space is {space}: leave out `goal`, or wrap the environment before "
            "FlattenObservation."
        )
    desired = goal_states(env, space, embedding, goal)
    if not isinstance(desired, GoalStates) or DESIRED not in desired.keys:
        raise UsageError(
            f"the goal {quoted(goal)} does not read {DESIRED}: give places such as "
            f"{{{embedding.inputs.names[0]!r}: '{DESIRED}[0]', ...}}; use PlanSpaceShaping for a fixed goal."
        )
    assert isinstance(desired.read, DictColumns)
    places = [(ACHIEVED if key == DESIRED else key, index) for key, index in desired.read.places]
    return GoalStates(DictColumns(places), desired.where, desired.constants), desired


def _in_order(embedding: Embedding, goal: Any) -> list[Any]:
    """The numbers and places of a goal in the embedding's order; an empty list if it has another type."""
    if isinstance(goal, Mapping):
        columns, values = embedding.columns_of(tuple(goal)), list(goal.values())
        return [values[c] for c in columns]
    if isinstance(goal, str) or not isinstance(goal, Sequence | np.ndarray):
        return []
    return list(goal)
