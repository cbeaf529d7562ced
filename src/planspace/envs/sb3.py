"""Our vector environments for Stable-Baselines3, which cannot use Gymnasium's (extra `sb3`)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from planspace.envs.observation_wrappers import PlanSpaceVectorObservation
from planspace.errors import PlanspaceError, UsageError

try:
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor
except ImportError as error:
    raise PlanspaceError(
        "Stable-Baselines3 is not installed: pip install 'planspace[sb3]', and before it the CPU "
        "build of torch where there is no GPU."
    ) from error


def make_vec_env(
    env_id: str,
    n_envs: int = 1,
    seed: int | None = None,
    embedding: str | Path | None = None,
    mode: str = "augment",
    monitor_file: str | Path | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
) -> VecMonitor:
    """Makes one of our tasks for Stable-Baselines3, all episodes on one batch of physics.

    As SB3's function of that name, episodes are monitored. Put `VecNormalize` around it as usual.

    Args:
        env_id: the task's name in Gymnasium, such as `planspace/CartPoleSwingUp-v0`.
        n_envs: how many episodes run side by side.
        seed: starts the random streams; None draws fresh ones.
        embedding: an embedding's folder, to show the agent z.
        mode: how, as for `PlanSpaceObservation`.
        monitor_file: where to write each episode's return and length, as SB3's `VecMonitor` does.
        env_kwargs: more arguments of the task, such as `{"obs": "trig"}`.

    Raises:
        UsageError: an argument does not fit; see `TaskVectorEnv` and `PlanSpaceVectorObservation`.
        PlanspaceError: the embedding cannot be loaded.
    """
    if gymnasium.spec(env_id.rpartition(":")[2]).vector_entry_point is None:
        raise UsageError(f"{env_id} has no vector environment of its own; use SB3's make_vec_env for it.")
    env: VectorEnv[Any, Any, Any] = gymnasium.make_vec(
        env_id,
        num_envs=n_envs,
        vectorization_mode="vector_entry_point",
        autoreset_mode=AutoresetMode.SAME_STEP.value,  # an enum would not survive the spec's JSON
        **(env_kwargs or {}),
    )
    if embedding is not None:
        env = PlanSpaceVectorObservation(env, embedding, mode)
    ours = GymnasiumVecEnv(env)
    if seed is not None:
        ours.seed(seed)
    return VecMonitor(ours, None if monitor_file is None else str(monitor_file))


class GymnasiumVecEnv(VecEnv):
    """A Gymnasium vector environment that resets in the same step, as an SB3 `VecEnv`."""

    def __init__(self, env: VectorEnv[Any, Any, Any]):
        """Takes the environment over.

        Args:
            env: made with `autoreset_mode="SameStep"`, as SB3 means it; wrappers of it do.

        Raises:
            UsageError: it resets in another way.
        """
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise UsageError(f"SB3 resets in the same step: take autoreset_mode='SameStep', not {mode}.")
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: Any = None

    def reset(self) -> Any:
        """Starts all episodes, with the seeds and options set since the last time."""
        seeds, options = None if None in self._seeds else list(self._seeds), self._options
        self._reset_seeds()
        self._reset_options()
        obs, info = self.env.reset(seed=seeds, options=_merged(options))  # pyright: ignore
        self.reset_infos = _one_by_one(info, self.num_envs)
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Takes the step; of an ended episode `infos` say how it ended, `reset_infos` how the next began."""
        obs, rewards, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        last, final = info.pop("final_obs", None), info.pop("final_info", {})
        infos, ends = _one_by_one(info, self.num_envs), _one_by_one(final, self.num_envs)
        for i in np.flatnonzero(done):
            self.reset_infos[i] = infos[i]
            infos[i] = ends[i] | {"terminal_observation": last[i]}
        for told, cut_off in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            told["TimeLimit.truncated"] = cut_off
        return obs, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Frees what the environment took."""
        self.env.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """The picture of each episode now."""
        images = self.env.render()
        return [None] * self.num_envs if images is None else list(images)  # pyright: ignore

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The vector environment's attribute, which its episodes share, once for each."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute of the vector environment.

        Raises:
            UsageError: it is asked for some episodes alone.
        """
        if indices is not None:
            raise UsageError(f"the episodes of one batch share {attr_name}; set it for all of them.")
        setattr(self.env.unwrapped, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Is refused.

        Raises:
            UsageError: always, because the episodes of one batch are no objects of their own.
        """
        raise UsageError(f"the episodes of one batch have no method {method_name} of their own.")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No episode is wrapped by itself."""
        return [False for _ in self._get_indices(indices)]


def _merged(options: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Each episode's options as those of the vector environment."""
    if not any(options):
        return None
    if any(set(one) != {"state"} for one in options) or len({np.shape(one["state"]) for one in options}) != 1:
        raise UsageError(f"all episodes can be given a state to start from, nothing else; got {options}.")
    return {"state": np.stack([one["state"] for one in options])}


def _one_by_one(info: Mapping[str, Any], num: int) -> list[dict[str, Any]]:
    """A vector environment's info as one for each episode."""
    infos: list[dict[str, Any]] = [{} for _ in range(num)]
    for name, values in info.items():
        if f"_{name}" not in info:  # a mask itself
            continue
        values = _one_by_one(values, num) if isinstance(values, Mapping) else values
        for i in np.flatnonzero(info[f"_{name}"]):
            infos[i][name] = values[i]
    return infos
