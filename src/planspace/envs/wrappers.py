"""An embedding in front of anyone's agent: z to look at, and distance in z as a reward on the way.

Each wrapper has a twin for vector environments, which encodes all episodes in one call. Arguments are plain
data (a path, names, numbers) and are recorded, so that a wrapped environment's spec survives JSON.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsFloat, get_args

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from planspace.embed.embedding import Embedding, load_embedding, norm
from planspace.envs.source import StateSource, source_of_columns, state_source, vector_state_source
from planspace.errors import UsageError, unknown

if TYPE_CHECKING:
    _VectorWrapper = VectorWrapper[Any, Any, Any, Any, Any]
else:
    _VectorWrapper = VectorWrapper  # no generic class before Gymnasium 1.3

Mode = Literal["augment", "replace", "dict"]
MODES: tuple[Mode, ...] = get_args(Mode)


class PlanSpaceObservation(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Shows the agent z, the mean of q(z|x): beside the observation, or instead of it."""

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        embedding: str | Path,
        mode: str = "augment",
        columns: Sequence[int] | None = None,
    ):
        """Wraps an environment.

        Args:
            env: the environment.
            embedding: the embedding's folder.
            mode: `augment` appends z to a flat observation, `replace` gives z alone, `dict` gives
                {"observation": what it was, "z": z}.
            columns: which numbers of the observation make the embedding's state, in its order; by default
                the state is read by name from the environment's `state` and `state_names`, as planspace's own
                have them, or from the joints of a MuJoCo environment.

        Raises:
            UsageError: the state cannot be read that way, the observation cannot be appended to, or the mode
                is unknown.
            PlanspaceError: the embedding cannot be loaded.
        """
        RecordConstructorArgs.__init__(self, **_recorded(embedding=embedding, mode=mode, columns=columns))
        super().__init__(env)
        self.embedding = load_embedding(embedding)
        self._source = state_source(env, self.embedding, columns)
        self.observation_space, self._show = _shown(env.observation_space, self.embedding, mode)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        return self._show(obs, self.embedding.encode(self._source(obs, info))), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Takes a step."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        z = self.embedding.encode(self._source(obs, info))
        return self._show(obs, z), reward, terminated, truncated, info


class PlanSpaceVectorObservation(_VectorWrapper, RecordConstructorArgs):
    """`PlanSpaceObservation` for a vector environment; `final_obs` is treated alike."""

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        embedding: str | Path,
        mode: str = "augment",
        columns: Sequence[int] | None = None,
    ):
        """Wraps a vector environment.

        Args:
            env: the vector environment.
            embedding: the embedding's folder.
            mode: as for `PlanSpaceObservation`.
            columns: which numbers of an observation make the embedding's state, in its order; by default
                `info["state"]` is read, by the environments' `state_names`.

        Raises:
            UsageError: the states cannot be read that way, the observation cannot be appended to, or the
                mode is unknown.
            PlanspaceError: the embedding cannot be loaded.
        """
        RecordConstructorArgs.__init__(self, **_recorded(embedding=embedding, mode=mode, columns=columns))
        super().__init__(env)
        self.embedding = load_embedding(embedding)
        self._source = vector_state_source(env, self.embedding, columns)
        self.single_observation_space, self._show = _shown(env.single_observation_space, self.embedding, mode)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._last: Any = None

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts all episodes, or those of a mask."""
        mask = None if options is None else options.get("reset_mask")
        obs, info = self.env.reset(seed=seed, options=options)  # pyright: ignore  a list of seeds, too
        z = self.embedding.encode(self._source(obs, info))
        begun = True if mask is None else np.asarray(mask)[:, None]
        self._last = z if self._last is None else np.where(begun, z, self._last)
        return self._show(obs, self._last), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Takes a step of every episode."""
        obs, rewards, terminated, truncated, info = self.env.step(actions)
        self._last = self.embedding.encode(self._source(obs, info))
        if "final_obs" in info:
            ended = np.flatnonzero(info["_final_obs"])
            last = np.stack(info["final_obs"][ended])
            z = self.embedding.encode(self._source(last, _rows(info.get("final_info", {}), ended)))
            for i, shown in zip(ended, _split(self._show(last, z), len(ended)), strict=True):
                info["final_obs"][i] = shown
        return self._show(obs, self._last), rewards, terminated, truncated, info


class PlanSpaceShaping(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Adds potential-based shaping to the reward: coming nearer to the goal in z is worth something.

    With the potential -scale |z - z_goal|, the reward of a step grows by discount * potential after -
    potential before; a state in which the episode terminated has potential 0. Which policy is best for the
    discounted return is left as it was (Ng, Harada and Russell 1999). `info["shaping"]` is what was added.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        embedding: str | Path,
        goal: Mapping[str, float] | Sequence[float] | None = None,
        scale: float = 1.0,
        discount: float = 0.99,
        columns: Sequence[int] | None = None,
        goal_columns: Sequence[int] | None = None,
    ):
        """Wraps an environment.

        Args:
            env: the environment.
            embedding: the embedding's folder.
            goal: the state to come to: by name, or in the embedding's order.
            scale: what a unit of distance in z is worth.
            discount: the agent's own discount.
            columns: where the state is in the observation, as for `PlanSpaceObservation`.
            goal_columns: in place of `goal`, where the goal's state is in the observation.

        Raises:
            UsageError: the states or the goal cannot be read that way.
            PlanspaceError: the embedding cannot be loaded.
        """
        RecordConstructorArgs.__init__(
            self,
            **_recorded(
                embedding=embedding,
                goal=goal,
                scale=scale,
                discount=discount,
                columns=columns,
                goal_columns=goal_columns,
            ),
        )
        super().__init__(env)
        self.embedding = load_embedding(embedding)
        source = state_source(env, self.embedding, columns)
        self._potential = _potential(self.embedding, source, goal, goal_columns, env.observation_space, scale)
        self._discount = _checked_discount(discount)
        self._before = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._before = float(self._potential(obs, info))
        info["shaping"] = 0.0
        return obs, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Takes a step."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        after = 0.0 if terminated else float(self._potential(obs, info))
        info["shaping"] = self._discount * after - self._before
        self._before = after
        return obs, float(reward) + info["shaping"], terminated, truncated, info


class PlanSpaceVectorShaping(_VectorWrapper, RecordConstructorArgs):
    """`PlanSpaceShaping` for a vector environment, whatever its autoreset mode."""

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        embedding: str | Path,
        goal: Mapping[str, float] | Sequence[float] | None = None,
        scale: float = 1.0,
        discount: float = 0.99,
        columns: Sequence[int] | None = None,
        goal_columns: Sequence[int] | None = None,
    ):
        """Wraps a vector environment; arguments and errors are those of `PlanSpaceShaping`."""
        RecordConstructorArgs.__init__(
            self,
            **_recorded(
                embedding=embedding,
                goal=goal,
                scale=scale,
                discount=discount,
                columns=columns,
                goal_columns=goal_columns,
            ),
        )
        super().__init__(env)
        self.embedding = load_embedding(embedding)
        source = vector_state_source(env, self.embedding, columns)
        self._potential = _potential(
            self.embedding, source, goal, goal_columns, env.single_observation_space, scale
        )
        self._discount = _checked_discount(discount)
        self._before = np.zeros(env.num_envs)
        self._restarting = np.zeros(env.num_envs, dtype=bool)
        self._next_step = env.metadata.get("autoreset_mode") == gymnasium.vector.AutoresetMode.NEXT_STEP

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts all episodes, or those of a mask."""
        mask = None if options is None else options.get("reset_mask")
        obs, info = self.env.reset(seed=seed, options=options)  # pyright: ignore  a list of seeds, too
        begun = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        self._before = np.where(begun, self._potential(obs, info), self._before)
        self._restarting = self._restarting & ~begun
        info["shaping"], info["_shaping"] = np.zeros(self.num_envs), begun.copy()
        return obs, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Takes a step of every episode."""
        obs, rewards, terminated, truncated, info = self.env.step(actions)
        now = after = self._potential(obs, info)
        told = np.ones(self.num_envs, dtype=bool)
        if "final_obs" in info:  # ended and begun anew in this step
            ended, after = np.flatnonzero(info["_final_obs"]), now.copy()
            last = np.stack(info["final_obs"][ended])
            after[ended] = self._potential(last, _rows(info.get("final_info", {}), ended))
        shaping = self._discount * np.where(terminated, 0.0, after) - self._before
        shaping[self._restarting] = 0.0
        self._before = now
        if self._next_step:
            self._restarting = terminated | truncated
        info["shaping"], info["_shaping"] = shaping, told
        if "final_obs" in info:  # it belongs to how those ended, not to how the next began
            over = info["_final_obs"]
            info["shaping"] = np.where(over, 0.0, shaping)
            info.setdefault("final_info", {}).update(
                shaping=np.where(over, shaping, 0.0), _shaping=over.copy()
            )
            info.setdefault("_final_info", over.copy())
        return obs, rewards + shaping, terminated, truncated, info


@dataclass(frozen=True)
class _View:
    """How what is shown is put together of an observation and z."""

    mode: Mode
    dtype: Any

    def __call__(self, obs: Any, z: np.ndarray) -> Any:
        if self.mode == "augment":
            return np.concatenate([obs, z], axis=-1, dtype=self.dtype)
        z = z.astype(self.dtype)
        return z if self.mode == "replace" else {"observation": obs, "z": z}


def _shown(
    space: gymnasium.Space[Any], embedding: Embedding, mode: str
) -> tuple[gymnasium.Space[Any], _View]:
    """The space of what is shown, and how it comes about."""
    z = Box(-np.inf, np.inf, (embedding.z_dim,), np.float32)
    if mode == "replace":
        return z, _View("replace", np.float32)
    if mode == "dict":
        return Dict({"observation": space, "z": z}), _View("dict", np.float32)
    if mode != "augment":
        raise unknown("mode", mode, MODES)
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise UsageError(
            f"z is appended to a flat Box, the observation is {space}; wrap FlattenObservation first, or "
            "take mode='dict'."
        )
    dtype: Any = space.dtype if np.issubdtype(space.dtype, np.floating) else np.float32  # pyright: ignore
    low, high = np.append(space.low, z.low).astype(dtype), np.append(space.high, z.high).astype(dtype)
    return Box(low, high, dtype=dtype), _View("augment", dtype)


@dataclass(frozen=True)
class _Potential:
    """(observation, info) to the potential of each state."""

    embedding: Embedding
    source: StateSource
    goal: np.ndarray | StateSource
    """z of the one goal, or where the goals' states are read."""
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
    """Puts the potential together of a shaping wrapper's arguments."""
    if not (isinstance(scale, Real) and np.isfinite(scale) and scale > 0):
        raise UsageError(f"scale must be a number above 0, got {scale!r}.")
    if goal is not None and goal_columns is None:
        return _Potential(embedding, source, embedding.encode(_goal_state(embedding, goal)), scale)
    if goal_columns is not None and goal is None:
        return _Potential(embedding, source, source_of_columns(space, embedding, goal_columns), scale)
    raise UsageError("give the goal, or goal_columns where it is in the observation: one of the two.")


def _goal_state(embedding: Embedding, goal: Mapping[str, float] | Sequence[float]) -> np.ndarray:
    """The goal as a state the embedding reads."""
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
            f"the goal is a finite state of {embedding.state_dim} numbers ({names}), got {goal!r}."
        )
    return state


def _checked_discount(discount: float) -> float:
    if not (isinstance(discount, Real) and 0 < discount <= 1):
        raise UsageError(f"discount must be a number above 0 and at most 1, got {discount!r}.")
    return discount


def _recorded(**arguments: Any) -> dict[str, Any]:
    """Constructor arguments as plain data, which JSON can hold."""

    def plain(value: Any) -> Any:
        if isinstance(value, Path):
            return str(value)
        if isinstance(value, Mapping):
            return {name: plain(v) for name, v in value.items()}
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        return (
            [plain(v) for v in value] if isinstance(value, Sequence) and not isinstance(value, str) else value
        )

    return {name: plain(value) for name, value in arguments.items()}


def _rows(info: Mapping[str, Any], rows: np.ndarray) -> dict[str, Any]:
    """The arrays of some episodes in a vector environment's info."""
    return {name: values[rows] for name, values in info.items() if isinstance(values, np.ndarray)}


def _split(shown: Any, num: int) -> list[Any]:
    """What is shown of some episodes, one by one."""
    if isinstance(shown, dict):
        return [{name: values[i] for name, values in shown.items()} for i in range(num)]
    return list(shown)
