"""Wrappers that add potential-based shaping to the reward: progress towards the goal in z is rewarded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv

from planspace.embed.embedding import Embedding, norm
from planspace.envs.source import StateSource, source_of_columns, state_source, vector_state_source
from planspace.envs.wrapper_arguments import VectorWrapperBase, embedding_from, recorded, rows_of
from planspace.errors import UsageError


class PlanSpaceShaping(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Add potential-based shaping to the reward: approaching the goal in z earns reward.

    The potential of a state is -scale |z - z_goal|, and 0 where an episode terminated. Each step earns in
    addition discount * (potential after it) - (potential before it). This does not change which policy has
    the highest discounted return (Ng, Harada and Russell 1999). `info["shaping"]` is the amount added.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        embedding: str | Path | Embedding,
        goal: Mapping[str, float] | Sequence[float] | None = None,
        scale: float = 1.0,
        discount: float = 0.99,
        columns: Sequence[int] | None = None,
        goal_columns: Sequence[int] | None = None,
    ):
        """Wrap an environment.

        Args:
            env: the environment.
            embedding: the embedding or its folder.
            goal: the goal state, as a mapping of names or as numbers in the embedding's order.
            scale: reward for one unit of distance in z.
            discount: the discount that the agent uses.
            columns: columns of the state in the observation, as for `PlanSpaceObservation`.
            goal_columns: columns of the goal's state in the observation, instead of `goal`.

        Raises:
            UsageError: the state or the goal cannot be read, or a number is out of range.
            PlanspaceError: the embedding cannot be loaded.
        """
        RecordConstructorArgs.__init__(
            self,
            **recorded(
                embedding=embedding,
                goal=goal,
                scale=scale,
                discount=discount,
                columns=columns,
                goal_columns=goal_columns,
            ),
        )
        super().__init__(env)
        self.embedding = embedding_from(embedding)
        source = state_source(env, self.embedding, columns)
        self._potential = _potential(self.embedding, source, goal, goal_columns, env.observation_space, scale)
        self._discount = _checked_discount(discount)
        self._before = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._before = float(self._potential(obs, info))
        info["shaping"] = 0.0
        return obs, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        after = 0.0 if terminated else float(self._potential(obs, info))
        info["shaping"] = self._discount * after - self._before
        self._before = after
        return obs, float(reward) + info["shaping"], terminated, truncated, info


class PlanSpaceVectorShaping(VectorWrapperBase, RecordConstructorArgs):
    """`PlanSpaceShaping` for a vector environment, for every autoreset mode."""

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        embedding: str | Path | Embedding,
        goal: Mapping[str, float] | Sequence[float] | None = None,
        scale: float = 1.0,
        discount: float = 0.99,
        columns: Sequence[int] | None = None,
        goal_columns: Sequence[int] | None = None,
    ):
        """Wrap a vector environment; for arguments and errors see `PlanSpaceShaping`."""
        RecordConstructorArgs.__init__(
            self,
            **recorded(
                embedding=embedding,
                goal=goal,
                scale=scale,
                discount=discount,
                columns=columns,
                goal_columns=goal_columns,
            ),
        )
        super().__init__(env)
        self.embedding = embedding_from(embedding)
        source = vector_state_source(env, self.embedding, columns)
        self._potential = _potential(
            self.embedding, source, goal, goal_columns, env.single_observation_space, scale
        )
        self._discount = _checked_discount(discount)
        self._before = np.zeros(env.num_envs)
        self._restarting = np.zeros(env.num_envs, dtype=bool)
        self._next_step = env.metadata.get("autoreset_mode") == AutoresetMode.NEXT_STEP

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes, or those in `options["reset_mask"]`."""
        mask = None if options is None else options.get("reset_mask")
        obs, info = self.env.reset(seed=seed, options=options)  # pyright: ignore  a list of seeds, too
        started = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        self._before = np.where(started, self._potential(obs, info), self._before)
        self._restarting = self._restarting & ~started
        info["shaping"], info["_shaping"] = np.zeros(self.num_envs), started.copy()
        return obs, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take a step in every environment."""
        obs, rewards, terminated, truncated, info = self.env.step(actions)
        now = after = self._potential(obs, info)
        if "final_obs" in info:  # these episodes ended, and others started in the same step
            ended, after = np.flatnonzero(info["_final_obs"]), now.copy()
            last = np.stack(info["final_obs"][ended])
            after[ended] = self._potential(last, rows_of(info.get("final_info", {}), ended))
        shaping = self._discount * np.where(terminated, 0.0, after) - self._before
        shaping[self._restarting] = 0.0
        self._before = now
        if self._next_step:
            self._restarting = terminated | truncated
        info["shaping"], info["_shaping"] = shaping, np.ones(self.num_envs, dtype=bool)
        if "final_obs" in info:
            _move_to_final_info(info, shaping)
        return obs, rewards + shaping, terminated, truncated, info


def _move_to_final_info(info: dict[str, Any], shaping: np.ndarray) -> None:
    """Record the shaping of the episodes that ended in their own info, not in that of the next episodes."""
    ended = info["_final_obs"]
    info["shaping"] = np.where(ended, 0.0, shaping)
    final = info.setdefault("final_info", {})
    final.update(shaping=np.where(ended, shaping, 0.0), _shaping=ended.copy())
    info.setdefault("_final_info", ended.copy())


@dataclass(frozen=True)
class _Potential:
    """Computes the potential of each state from (observation, info)."""

    embedding: Embedding
    source: StateSource
    goal: np.ndarray | StateSource
    """z of the goal, or what reads the states of the goals."""
    scale: float

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        encode, goal = self.embedding.encode, self.goal
        z_goal = goal if isinstance(goal, np.ndarray) else encode(goal(obs, info))
        return np.asarray(-self.scale * norm(encode(self.source(obs, info)) - z_goal), dtype=float)


def _potential(
    embedding: Embedding,
    source: StateSource,
    goal: Mapping[str, float] | Sequence[float] | None,
    goal_columns: Sequence[int] | None,
    space: gymnasium.Space[Any],
    scale: float,
) -> _Potential:
    """Build the potential from the arguments of a shaping wrapper."""
    if not (isinstance(scale, Real) and np.isfinite(scale) and scale > 0):
        raise UsageError(f"scale must be a number above 0, got {scale!r}.")
    if goal is not None and goal_columns is None:
        return _Potential(embedding, source, embedding.encode(_goal_state(embedding, goal)), scale)
    if goal_columns is not None and goal is None:
        return _Potential(embedding, source, source_of_columns(space, embedding, goal_columns), scale)
    raise UsageError("give either the goal, or goal_columns, the columns of the goal in the observation.")


def _goal_state(embedding: Embedding, goal: Mapping[str, float] | Sequence[float]) -> np.ndarray:
    """Return the goal as a state in the embedding's order."""
    if isinstance(goal, Mapping):
        where = embedding.columns_of(tuple(goal))
        goal = [list(goal.values())[c] for c in where]
    try:
        state = np.asarray(goal, dtype=float)
    except (TypeError, ValueError):
        state = np.empty(0)
    if state.shape != (embedding.state_dim,) or not np.isfinite(state).all():
        names = ", ".join(embedding.inputs.names)
        raise UsageError(
            f"the goal must be a state of {embedding.state_dim} finite numbers ({names}), got {goal!r}."
        )
    return state


def _checked_discount(discount: float) -> float:
    if not (isinstance(discount, Real) and 0 < discount <= 1):
        raise UsageError(f"discount must be a number above 0 and at most 1, got {discount!r}.")
    return discount
