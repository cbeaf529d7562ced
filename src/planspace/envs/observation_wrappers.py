"""Wrappers that show an agent z, the mean of q(z|x), next to the observation or in its place."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, SupportsFloat, get_args

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from planspace.embed.embedding import Embedding
from planspace.envs.source import state_source, vector_state_source
from planspace.envs.wrapper_arguments import VectorWrapperBase, embedding_from, recorded, rows_of
from planspace.errors import UsageError, unknown

Mode = Literal["augment", "replace", "dict"]
MODES: tuple[Mode, ...] = get_args(Mode)


class PlanSpaceObservation(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Show the agent z, the mean of q(z|x), next to the observation or in its place."""

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        embedding: str | Path | Embedding,
        mode: str = "augment",
        columns: Sequence[int] | None = None,
    ):
        """Wrap an environment.

        Args:
            env: the environment.
            embedding: the embedding or its folder.
            mode: `augment` appends z to a flat observation, `replace` returns only z, `dict` returns
                {"observation": the original observation, "z": z}.
            columns: the columns of the observation that make the embedding's state, in the embedding's
                order. None reads the state by name: from the attributes `state` and `state_names` of the
                environment, which planspace's own have, or from the joints of a MuJoCo environment.

        Raises:
            UsageError: the state cannot be read, z cannot be appended to the observation, or the mode is
                unknown.
            PlanspaceError: the embedding cannot be loaded.
        """
        RecordConstructorArgs.__init__(self, **recorded(embedding=embedding, mode=mode, columns=columns))
        super().__init__(env)
        self.embedding = embedding_from(embedding)
        self._source = state_source(env, self.embedding, columns)
        self.observation_space, self._view = _view_of(env.observation_space, self.embedding, mode)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        return self._view(obs, self.embedding.encode(self._source(obs, info))), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        z = self.embedding.encode(self._source(obs, info))
        return self._view(obs, z), reward, terminated, truncated, info


class PlanSpaceVectorObservation(VectorWrapperBase, RecordConstructorArgs):
    """`PlanSpaceObservation` for a vector environment: all states are encoded in one call."""

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        embedding: str | Path | Embedding,
        mode: str = "augment",
        columns: Sequence[int] | None = None,
    ):
        """Wrap a vector environment.

        Args:
            env: the vector environment.
            embedding: the embedding or its folder.
            mode: as for `PlanSpaceObservation`.
            columns: the columns of an observation that make the embedding's state, in the embedding's order.
                None reads `info["state"]`, whose names are the environments' `state_names`.

        Raises:
            UsageError: the states cannot be read, z cannot be appended to the observations, or the mode is
                unknown.
            PlanspaceError: the embedding cannot be loaded.
        """
        RecordConstructorArgs.__init__(self, **recorded(embedding=embedding, mode=mode, columns=columns))
        super().__init__(env)
        self.embedding = embedding_from(embedding)
        self._source = vector_state_source(env, self.embedding, columns)
        self.single_observation_space, self._view = _view_of(
            env.single_observation_space, self.embedding, mode
        )
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._last_z: Any = None

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
        self._last_z = self.embedding.encode(self._source(obs, info))
        if "final_obs" in info:
            ended = np.flatnonzero(info["_final_obs"])
            last = np.stack(info["final_obs"][ended])
            z = self.embedding.encode(self._source(last, rows_of(info.get("final_info", {}), ended)))
            for i, shown in zip(ended, _split(self._view(last, z), len(ended)), strict=True):
                info["final_obs"][i] = shown
        return self._view(obs, self._last_z), rewards, terminated, truncated, info


@dataclass(frozen=True)
class _View:
    """Combines an observation and z into what the agent sees."""

    mode: Mode
    dtype: Any

    def __call__(self, obs: Any, z: np.ndarray) -> Any:
        if self.mode == "augment":
            return np.concatenate([obs, z], axis=-1, dtype=self.dtype)
        z = z.astype(self.dtype)
        return z if self.mode == "replace" else {"observation": obs, "z": z}


def _view_of(
    space: gymnasium.Space[Any], embedding: Embedding, mode: str
) -> tuple[gymnasium.Space[Any], _View]:
    """Return the observation space that the agent sees, and what makes its observations."""
    z = Box(-np.inf, np.inf, (embedding.z_dim,), np.float32)
    if mode == "replace":
        return z, _View("replace", np.float32)
    if mode == "dict":
        return Dict({"observation": space, "z": z}), _View("dict", np.float32)
    if mode != "augment":
        raise unknown("mode", mode, MODES)
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise UsageError(
            f"z can only be appended to a flat Box, and the observation space is {space}: wrap the "
            "environment in FlattenObservation first, or use mode='dict'."
        )
    dtype: Any = space.dtype if np.issubdtype(space.dtype, np.floating) else np.float32  # pyright: ignore
    low, high = np.append(space.low, z.low).astype(dtype), np.append(space.high, z.high).astype(dtype)
    return Box(low, high, dtype=dtype), _View("augment", dtype)


def _split(shown: Any, num: int) -> list[Any]:
    """Split a batch of observations into single ones."""
    if isinstance(shown, dict):
        return [{name: values[i] for name, values in shown.items()} for i in range(num)]
    return list(shown)
