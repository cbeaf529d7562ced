"""What the agent sees: an observation with z, and z of goals, next to it or in its place."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict

from planspace.embed.embedding import Embedding
from planspace.envs.columns import Environment
from planspace.envs.embedding_box import append_z, z_space
from planspace.envs.goal_states import Goal, GoalStates, observed_goals
from planspace.errors import UsageError, unknown

Mode = Literal["augment", "replace", "dict"]
MODES: tuple[Mode, ...] = get_args(Mode)
Z, OBSERVATION = "z", "observation"
GOAL_SUFFIXES = ("achieved_goal", "desired_goal", "difference")
"""The entries for goals are `z_` and one of these: z of both goals, and the second minus the first."""


@dataclass(frozen=True)
class GoalView:
    """Computes the entries for z of the goals from an observation of a goal environment."""

    names: tuple[str, ...]
    """The entries: z of the achieved goal, of the desired goal, and the second minus the first."""
    embedding: Embedding
    achieved: GoalStates
    desired: GoalStates

    def __call__(self, obs: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Return the entries, with the leading axes of the observation."""
        states = np.stack([self.achieved(obs, {}), self.desired(obs, {})])
        achieved, desired = self.embedding.encode(states).astype(np.float32)
        return dict(zip(self.names, (achieved, desired, desired - achieved), strict=True))


@dataclass(frozen=True)
class ObservationView:
    """Combines observations and z into what the agent sees."""

    space: gymnasium.Space[Any]
    """The observation space of the agent."""
    append: bool
    """Whether z is appended to a flat observation."""
    keep: bool
    """Whether the observation is shown."""
    key: str = Z
    """The entry for z in a dictionary."""
    goals: GoalView | None = None
    """Computes z of the goals; None if it is not shown."""

    def __call__(self, obs: Any, z: np.ndarray) -> Any:
        """Return what the agent sees of a batch of observations, or of one."""
        if self.append:
            return np.concatenate([obs, z], axis=-1, dtype=self.space.dtype)  # pyright: ignore
        z = z.astype(np.float32)
        if not isinstance(self.space, Dict):
            return z
        kept = {} if not self.keep else obs if isinstance(obs, dict) else {OBSERVATION: obs}
        return {**kept, self.key: z, **(self.goals(obs) if self.goals else {})}


def observation_view(
    env: Environment,
    space: gymnasium.Space[Any],
    embedding: Embedding,
    mode: str,
    goal: Goal | None,
    key: str,
) -> ObservationView:
    """Return the observation space that the agent sees, and what makes its observations.

    Args:
        env: the environment.
        space: the observation space of a single environment.
        embedding: the embedding.
        mode: as for `PlanSpaceObservation`.
        goal: as for `PlanSpaceObservation`.
        key: as for `PlanSpaceObservation`.

    Raises:
        UsageError: the mode is unknown or does not fit the space, or the goals cannot be read.
    """
    if mode not in MODES:
        raise unknown("mode", mode, MODES)
    goals = None
    if goal is not None:
        names = tuple(f"{key}_{suffix}" for suffix in GOAL_SUFFIXES)
        goals = GoalView(names, embedding, *observed_goals(env, space, embedding, goal))
    z = z_space(embedding.z_dim, embedding.hash)
    ours: dict[str, gymnasium.Space[Any]] = dict.fromkeys((key, *goals.names) if goals else (key,), z)
    if mode == "replace":
        return ObservationView(Dict(ours) if goals else z, append=False, keep=False, key=key, goals=goals)
    if isinstance(space, Dict):
        if taken := set(ours) & set(space.spaces):
            raise UsageError(
                f"the observation already has an entry {min(taken)!r}: give this z another name with `key`."
            )
        return ObservationView(Dict({**space.spaces, **ours}), append=False, keep=True, key=key, goals=goals)
    if mode == "dict":
        return ObservationView(Dict({OBSERVATION: space, **ours}), append=False, keep=True, key=key)
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise UsageError(
            f"z can only be appended to a flat Box or added to a Dict, and the observation space is {space}: "
            "wrap the environment in FlattenObservation first, or use mode='dict'."
        )
    return ObservationView(append_z(space, embedding.z_dim, embedding.hash), append=True, keep=True)
