"""Wrappers that show an agent z, the mean of q(z|x), next to the observation or in its place."""

import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from planspace.embed.embedding import Embedding
from planspace.envs.columns import Column
from planspace.envs.final_observations import replace_last_observations
from planspace.envs.goal_states import Goal
from planspace.envs.input_check import InputCheck
from planspace.envs.observation_view import MODES, GoalView, Mode, Z, observation_view
from planspace.envs.source import state_source, vector_state_source
from planspace.envs.wrapper_arguments import VectorWrapperBase, embedding_from, recorded, rows_of

__all__ = ["MODES", "Mode", "PlanSpaceObservation", "PlanSpaceVectorObservation"]


class PlanSpaceObservation(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Show the agent z, the mean of q(z|x), next to the observation or in its place."""

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        embedding: str | Path | Embedding,
        mode: str = "augment",
        columns: Sequence[Column] | None = None,
        goal: Goal | None = None,
        key: str = Z,
    ):
        """Wrap an environment.

        Args:
            env: the environment.
            embedding: the embedding or its folder.
            mode: `augment` appends z to a flat observation, `replace` returns only z, `dict` returns
                {"observation": the original observation, "z": z}. A dictionary observation gets the entry
                `z` with both `augment` and `dict`.
            columns: the columns of the observation that make the embedding's state, in the embedding's
                order: numbers, or names such as `observation[0]` of entries of a dictionary, also of one that
                FlattenObservation has flattened. None reads the state by name: from the attributes `state`
                and `state_names` of the environment, which planspace's own have, or from the joints of a
                MuJoCo environment.
            goal: where the desired goal of a goal environment has the embedding's state, such as
                {"x": "desired_goal[0]", "vx": 0.0}. The observation then also has `z_achieved_goal`,
                `z_desired_goal`, and `z_difference`, the second minus the first. With HER, use
                `planspace.envs.her.PlanSpaceHerReplayBuffer`, which computes them for relabelled goals.
            key: the name of the entry `z` in a dictionary, and the first part of those for goals.

        Raises:
            UsageError: the state cannot be read, z cannot be appended to the observation, or the mode is
                unknown.
            PlanspaceError: the embedding cannot be loaded.
        """
        RecordConstructorArgs.__init__(
            self, **recorded(embedding=embedding, mode=mode, columns=columns, goal=goal, key=key)
        )
        super().__init__(env)
        self.embedding = embedding_from(embedding)
        self._source = state_source(env, self.embedding, columns)
        self._view = observation_view(env, env.observation_space, self.embedding, mode, goal, key)
        self.observation_space = self._view.space
        self._check = InputCheck(env, self.embedding, columns is not None)
        self._goals_may_be_stale = self._view.goals is not None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        return self._view(obs, self._encode(obs, info)), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        return self._view(obs, self._encode(obs, info)), reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Compute the reward of the environment for other goals, as HER does; z does not change it."""
        if np.ndim(desired_goal) > 1 and self._goals_may_be_stale:
            self._goals_may_be_stale = False  # warn once
            warnings.warn(
                "rewards are computed for relabelled goals, but z_desired_goal and z_difference are not: use "
                "planspace.envs.her.PlanSpaceHerReplayBuffer, or call `recompute_goals` and apply the "
                "functions that it returns to each relabelled observation.",
                stacklevel=2,
            )
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)

    def recompute_goals(self) -> list[GoalView]:
        """Return what computes the entries for z of the goals from an observation, for a replay buffer.

        Returns:
            One function for this wrapper and each one below it that adds such entries.
        """
        self._goals_may_be_stale = False
        name = "recompute_goals"
        below = self.env.get_wrapper_attr(name)() if self.env.has_wrapper_attr(name) else []
        return [*below, *([self._view.goals] if self._view.goals else [])]

    def _encode(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        return self.embedding.encode(self._check(self._source(obs, info)))


class PlanSpaceVectorObservation(VectorWrapperBase, RecordConstructorArgs):
    """`PlanSpaceObservation` for a vector environment: all states are encoded in one call."""

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        embedding: str | Path | Embedding,
        mode: str = "augment",
        columns: Sequence[Column] | None = None,
        goal: Goal | None = None,
        key: str = Z,
    ):
        """Wrap a vector environment.

        Args:
            env: the vector environment.
            embedding: the embedding or its folder.
            mode: as for `PlanSpaceObservation`.
            columns: the columns of an observation that make the embedding's state, as for
                `PlanSpaceObservation`. None reads `info["state"]`, whose names are the environments'
                `state_names`.
            goal: as for `PlanSpaceObservation`.
            key: as for `PlanSpaceObservation`.

        Raises:
            UsageError: the states cannot be read, z cannot be appended to the observations, or the mode is
                unknown.
            PlanspaceError: the embedding cannot be loaded.
        """
        RecordConstructorArgs.__init__(
            self, **recorded(embedding=embedding, mode=mode, columns=columns, goal=goal, key=key)
        )
        super().__init__(env)
        self.embedding = embedding_from(embedding)
        self._source = vector_state_source(env, self.embedding, columns)
        self._view = observation_view(env, env.single_observation_space, self.embedding, mode, goal, key)
        self.single_observation_space = self._view.space
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._last_z: Any = None
        self._check = InputCheck(env, self.embedding, columns is not None)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes, or those in `options["reset_mask"]`."""
        mask = None if options is None else options.get("reset_mask")
        obs, info = self.env.reset(seed=seed, options=options)  # pyright: ignore  a list of seeds, too
        z = self.embedding.encode(self._source(obs, info))
        started = True if mask is None else np.asarray(mask)[:, None]
        self._last_z = z if self._last_z is None else np.where(started, z, self._last_z)
        return self._view(obs, self._last_z), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take a step in every environment; z is also added to the observations in `final_obs`."""
        obs, rewards, terminated, truncated, info = self.env.step(actions)
        self._last_z = self.embedding.encode(self._check(self._source(obs, info)))
        if "final_obs" in info:
            replace_last_observations(info, partial(self._last_view, info.get("final_info", {})))
        return self._view(obs, self._last_z), rewards, terminated, truncated, info

    def _last_view(self, infos: dict[str, Any], last: Any, ended: np.ndarray) -> Any:
        """What the agent sees of the last observations of the episodes that ended."""
        return self._view(last, self.embedding.encode(self._source(last, rows_of(infos, ended))))
