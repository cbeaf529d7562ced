"""Vector environments for Stable-Baselines3, which cannot use those of Gymnasium (extra `sb3`)."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from planspace.embed.embedding import Embedding
from planspace.envs.final_observations import last_observation
from planspace.envs.make import make_env
from planspace.envs.observation_wrappers import PlanSpaceVectorObservation
from planspace.errors import PlanspaceError, UsageError, install_command

try:
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor
except ImportError as error:
    raise PlanspaceError(
        f"Stable-Baselines3 is not installed: {install_command('sb3')}. On a machine without a GPU, "
        "install the CPU build of torch first."
    ) from error

VERSIONED = re.compile(r"-v\d+$")
"""How a Gymnasium id ends."""


def make_vec_env(
    env_id: str | Path,
    n_envs: int = 1,
    seed: int | None = None,
    embedding: str | Path | Embedding | None = None,
    mode: str = "augment",
    monitor_file: str | Path | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
) -> VecMonitor:
    """Make a task's vector environment for Stable-Baselines3, in one batch of simulations.

    Like SB3's function of the same name, it monitors episodes. Wrap it in `VecNormalize` as usual.

    Args:
        env_id: the task's Gymnasium id, such as `planspace/CartPoleSwingUp-v0`, or what `planspace.make_env`
            takes: the name of a task or the path of a problem file (`.yaml`).
        n_envs: number of environments.
        seed: the seed of the random streams; None draws one.
        embedding: an embedding or its folder, to show the agent z.
        mode: how z is shown, as for `PlanSpaceObservation`.
        monitor_file: file for each episode's return and length, as in SB3's `VecMonitor`.
        env_kwargs: further arguments of the environment, such as `{"obs": "trig"}`.

    Raises:
        UsageError: an argument is wrong; see `TaskVectorEnv` and `PlanSpaceVectorObservation`.
        PlanspaceError: the embedding cannot be loaded.
    """
    arguments = {"autoreset_mode": AutoresetMode.SAME_STEP.value, **(env_kwargs or {})}  # JSON has no enum
    if VERSIONED.search(str(env_id)):
        env = _make_registered(str(env_id), n_envs, arguments)
    else:
        env = make_env(env_id, n_envs, **arguments)
    if embedding is not None:
        env = PlanSpaceVectorObservation(env, embedding, mode)
    ours = GymnasiumVecEnv(env)
    if seed is not None:
        ours.seed(seed)
    return VecMonitor(ours, None if monitor_file is None else str(monitor_file))


def _make_registered(env_id: str, n_envs: int, arguments: dict[str, Any]) -> VectorEnv[Any, Any, Any]:
    """The vector environment of a Gymnasium id."""
    if gymnasium.spec(env_id.rpartition(":")[2]).vector_entry_point is None:
        raise UsageError(
            f"{env_id} has no vector environment; use SB3's own make_vec_env for it, with "
            "wrapper_class=PlanSpaceObservation if an agent is to see z."
        )
    try:
        return gymnasium.make_vec(
            env_id, num_envs=n_envs, vectorization_mode="vector_entry_point", **arguments
        )
    except TypeError as error:
        if "autoreset_mode" not in str(error):
            raise
        raise UsageError(
            f"the vector environment of {env_id} has no argument autoreset_mode, and SB3 needs 'SameStep'; "
            "use SB3's own make_vec_env for it, with wrapper_class=PlanSpaceObservation if an agent is to "
            "see z."
        ) from error


class GymnasiumVecEnv(VecEnv):
    """A Gymnasium vector environment as a `VecEnv` of SB3."""

    def __init__(self, env: VectorEnv[Any, Any, Any]):
        """Use a vector environment.

        Args:
            env: the environment, wrapped or not, with `autoreset_mode="SameStep"`, as SB3 expects.

        Raises:
            UsageError: it has another autoreset mode.
        """
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise UsageError(f"SB3 needs environments with autoreset_mode='SameStep', got {mode}.")
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: Any = None

    def reset(self) -> Any:
        """Start all episodes, with the seeds and options that were set since the last reset."""
        seeds, options = None if None in self._seeds else list(self._seeds), self._options
        self._reset_seeds()
        self._reset_options()
        obs, info = self.env.reset(seed=seeds, options=_merged(options))  # pyright: ignore
        self.reset_infos = _one_by_one(info, self.num_envs)
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the step; for an episode that ended, `reset_infos` has the info of the next one."""
        obs, rewards, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        last, final = info.pop("final_obs", None), info.pop("final_info", {})
        infos, ends = _one_by_one(info, self.num_envs), _one_by_one(final, self.num_envs)
        for i in np.flatnonzero(done):
            self.reset_infos[i] = infos[i]
            infos[i] = ends[i] | {"terminal_observation": last_observation(last, int(i))}
        for info_of_one, cut_off in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            info_of_one["TimeLimit.truncated"] = cut_off
        return obs, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return an image of each environment."""
        images = self.env.render()
        return [None] * self.num_envs if images is None else list(images)  # pyright: ignore

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the vector environment, once for each environment."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the vector environment.

        Raises:
            UsageError: `indices` chooses some of the environments.
        """
        if indices is not None:
            raise UsageError(f"all environments share {attr_name}: set it without indices.")
        setattr(self.env.unwrapped, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Raise an error.

        Raises:
            UsageError: always, because there are no single environments whose method could be called.
        """
        raise UsageError(f"cannot call {method_name}: the vector environment has no single environments.")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each environment: single environments are not wrapped."""
        return [False for _ in self._get_indices(indices)]


def _merged(options: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """The options of all environments, combined for the vector environment."""
    if not any(options):
        return None
    if any(set(one) != {"state"} for one in options) or len({np.shape(one["state"]) for one in options}) != 1:
        raise UsageError(f"the only option is a start state for every environment, got {options}.")
    return {"state": np.stack([one["state"] for one in options])}


def _one_by_one(info: Mapping[str, Any], num: int) -> list[dict[str, Any]]:
    """A vector environment's info, split into one for each environment."""
    infos: list[dict[str, Any]] = [{} for _ in range(num)]
    for name, values in info.items():
        if f"_{name}" not in info:  # it is a mask
            continue
        values = _one_by_one(values, num) if isinstance(values, Mapping) else values
        for i in np.flatnonzero(info[f"_{name}"]):
            infos[i][name] = values[i]
    return infos
