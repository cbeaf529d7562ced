"""Wrappers that add potential-based shaping to the reward: progress towards the goal in z is rewarded."""

from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv

from planspace.embed.embedding import Embedding
from planspace.envs.columns import Column
from planspace.envs.final_observations import last_observations
from planspace.envs.goal_states import Goal, goal_states
from planspace.envs.input_check import InputCheck
from planspace.envs.potential import RELABELLING, Potential, check_scale, find_goal
from planspace.envs.source import state_source, vector_state_source
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
        goal: Goal | None = None,
        scale: float = 1.0,
        discount: float = 0.99,
        columns: Sequence[Column] | None = None,
        goal_columns: Sequence[Column] | None = None,
    ):
        """Wrap an environment.

        Args:
            env: the environment.
            embedding: the embedding or its folder.
            goal: the goal state, as a mapping of names or as numbers in the embedding's order. Instead of a
                number, the place of one in the observation, such as {"x": "desired_goal[0]", "vx": 0.0} in a
                goal environment. HER then needs `PlanSpaceHerReplayBuffer` or `copy_info_dict=True`.
            scale: reward for one unit of distance in z.
            discount: the discount that the agent uses.
            columns: columns of the state in the observation, as for `PlanSpaceObservation`.
            goal_columns: columns of the goal's whole state in the observation, instead of `goal`.

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
        check = InputCheck(env, self.embedding, columns is not None)
        found = goal_states(env, env.observation_space, self.embedding, find_goal(goal, goal_columns))
        self._potential = Potential(self.embedding, source, check, found, check_scale(scale))
        self._discount = _checked_discount(discount)
        self._before, self._z = 0.0, np.empty(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._z = self._potential.encode(obs, info)
        self._before = float(self._potential.of(self._z, obs, info))
        info["shaping"] = 0.0
        return obs, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        z = self._potential.encode(obs, info)
        after = 0.0 if terminated else float(self._potential.of(z, obs, info))
        info["shaping"] = self._discount * after - self._before
        if self._potential.is_relabelled:
            info[RELABELLING] = np.stack([self._z, np.full_like(z, np.nan) if terminated else z])
        self._before, self._z = after, z
        return obs, float(reward) + info["shaping"], terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Compute the reward of the environment and the shaping for other goals, as HER does.

        Args:
            achieved_goal: the achieved goal after the step, or a batch of them.
            desired_goal: the goal to assume.
            info: the info of the step, or a sequence of infos for a batch.

        Raises:
            UsageError: an info is not that of a step, so that the shaping cannot be computed.
        """
        reward = self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)
        if isinstance(info, dict):
            goals = np.asarray(desired_goal)[None]
            return reward + float(self._potential.relabelled_shaping([info], goals, self._discount)[0])
        infos, goals = list(info), np.asarray(desired_goal)
        return reward + self._potential.relabelled_shaping(infos, goals, self._discount)


class PlanSpaceVectorShaping(VectorWrapperBase, RecordConstructorArgs):
    """`PlanSpaceShaping` for a vector environment, for every autoreset mode."""

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        embedding: str | Path | Embedding,
        goal: Goal | None = None,
        scale: float = 1.0,
        discount: float = 0.99,
        columns: Sequence[Column] | None = None,
        goal_columns: Sequence[Column] | None = None,
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
        check = InputCheck(env, self.embedding, columns is not None)
        space = env.single_observation_space
        found = goal_states(env, space, self.embedding, find_goal(goal, goal_columns))
        self._potential = Potential(self.embedding, source, check, found, check_scale(scale))
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
            after = now.copy()
            ended, last = last_observations(info)
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


def _checked_discount(discount: float) -> float:
    if not (isinstance(discount, Real) and 0 < discount <= 1):
        raise UsageError(f"discount must be a number above 0 and at most 1, got {discount!r}.")
    return discount
