"""Making and wrapping environments: `planspace.make_env` and `planspace.wrap`."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, overload

import gymnasium
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import SyncVectorEnv, VectorEnv

from planspace.embed.embedding import Embedding
from planspace.envs.columns import Column
from planspace.envs.goal_states import Goal
from planspace.envs.gymnasium_env import GymTaskEnv
from planspace.envs.observation_view import Z
from planspace.envs.observation_wrappers import PlanSpaceObservation, PlanSpaceVectorObservation
from planspace.errors import UsageError, check_whole, quoted
from planspace.tasks.catalog import TASKS
from planspace.tasks.gymnasium import AnyTask, GymTask, find_training_task
from planspace.tasks.observation_types import find_name
from planspace.tasks.task import Task


@overload
def make_env(
    task: str | Path | AnyTask,
    num_envs: None = None,
    *,
    embedding: str | Path | Embedding | None = None,
    mode: str = "augment",
    **arguments: Any,
) -> gymnasium.Env[Any, Any]: ...
@overload
def make_env(
    task: str | Path | AnyTask,
    num_envs: int,
    *,
    embedding: str | Path | Embedding | None = None,
    mode: str = "augment",
    **arguments: Any,
) -> VectorEnv[Any, Any, Any]: ...
def make_env(
    task: str | Path | AnyTask,
    num_envs: int | None = None,
    *,
    obs: str = "raw",
    reward: str = "dense",
    embedding: str | Path | Embedding | None = None,
    mode: str = "augment",
    render_mode: str | None = None,
    **arguments: Any,
) -> gymnasium.Env[Any, Any] | VectorEnv[Any, Any, Any]:
    """Make the environment of a task, as `gymnasium.make` would, with or without an embedding.

    Args:
        task: the name of a task, the path of a problem file (`.yaml`), a task of your own, or a Gymnasium
            environment as `gym:ID` or `GymTask`.
        num_envs: number of environments in one vector environment; None makes a single environment.
        obs: `raw`, `wrapped` (angles of unlimited hinges within (-pi, pi]), `trig` (raw, sine and cosine) or
            `pixels` (the last pictures; see docs/pixels.md).
        reward: `dense`, `sparse` (1 at the goal, 0 elsewhere) or `2020` (if the task has it).
        embedding: an embedding or its folder, to show the agent z.
        mode: how z is shown, as for `PlanSpaceObservation`.
        render_mode: `rgb_array`, `human` (single environments only), or None.
        arguments: further arguments of `gymnasium.make`, or of `TaskVectorEnv`: `max_episode_steps`,
            `autoreset_mode`, `threads`, and `pictures`, a `PictureConfig`, for `pixels`.

    Returns:
        An environment of Gymnasium; seed it with `env.reset(seed=...)`.

    Raises:
        UsageError: no task has this name, a task does not fit its model, or an argument has a wrong value.
        PlanspaceError: the embedding cannot be loaded.
    """
    if num_envs is not None:
        check_whole("num_envs", num_envs)
    arguments |= {"obs": obs, "reward": reward, "render_mode": render_mode}
    found = find_training_task(task)
    if isinstance(found, GymTask):
        env = _make_gymnasium(found, num_envs, **arguments)
    elif num_envs is None:
        env = gymnasium.make(_spec_of(found), **arguments)
    else:
        env = gymnasium.make_vec(
            _spec_of(found), num_envs=num_envs, vectorization_mode="vector_entry_point", **arguments
        )
    return env if embedding is None else wrap(env, embedding, mode)


@overload
def wrap(
    env: VectorEnv[Any, Any, Any],
    embedding: str | Path | Embedding,
    mode: str = "augment",
    columns: Sequence[Column] | None = None,
    goal: Goal | None = None,
    key: str = Z,
) -> PlanSpaceVectorObservation: ...
@overload
def wrap(
    env: gymnasium.Env[Any, Any],
    embedding: str | Path | Embedding,
    mode: str = "augment",
    columns: Sequence[Column] | None = None,
    goal: Goal | None = None,
    key: str = Z,
) -> PlanSpaceObservation: ...
def wrap(
    env: Any,
    embedding: str | Path | Embedding,
    mode: str = "augment",
    columns: Sequence[Column] | None = None,
    goal: Goal | None = None,
    key: str = Z,
) -> PlanSpaceObservation | PlanSpaceVectorObservation:
    """Show an agent z: wrap a single or a vector environment of Gymnasium.

    Args:
        env: the environment.
        embedding: the embedding or its folder.
        mode: `augment` appends z to a flat observation and adds it to a dictionary, `replace` returns only z,
            `dict` returns both.
        columns: the columns of the observation that make the embedding's state; None reads the state by
            name (see `PlanSpaceObservation`).
        goal: where the desired goal of a goal environment has the embedding's state, to show z of the goals
            (see `PlanSpaceObservation`).
        key: the name of the entry `z` in a dictionary observation.

    Raises:
        UsageError: the environment is of another kind, or the embedding does not fit it.
        PlanspaceError: the embedding cannot be loaded.
    """
    if isinstance(env, VectorEnv):
        return PlanSpaceVectorObservation(env, embedding, mode, columns, goal, key)
    if isinstance(env, gymnasium.Env):
        return PlanSpaceObservation(env, embedding, mode, columns, goal, key)
    kind = f"{type(env).__module__}.{type(env).__qualname__}"
    if any(base.__module__.startswith("stable_baselines3.") for base in type(env).__mro__):
        raise UsageError(
            f"wrap takes environments of Gymnasium, got {kind}: wrap each environment before "
            "Stable-Baselines3 vectorises it, or use planspace.envs.sb3.make_vec_env(..., embedding=...)."
        )
    if isinstance(env, str):
        raise UsageError(f"wrap takes an environment, got {quoted(env)}: use gymnasium.make({env!r}).")
    raise UsageError(
        f"wrap takes a gymnasium.Env or a gymnasium.vector.VectorEnv, got {kind}: convert it first, for "
        "example with Shimmy."
    )


def _make_gymnasium(
    task: GymTask, num_envs: int | None, obs: str, reward: str, render_mode: str | None, **arguments: Any
) -> gymnasium.Env[Any, Any] | VectorEnv[Any, Any, Any]:
    """Make the environment of a Gymnasium task, or many of them in one process."""
    find_name(f"observation type of {task.name}", obs, task.obs_types)
    find_name(f"reward type of {task.name}", reward, task.reward_types)
    if arguments:
        raise UsageError(f"give the arguments of {task.name} to its GymTask, got {quoted(arguments)}.")
    if num_envs is None:
        return GymTaskEnv(task, render_mode)
    return SyncVectorEnv([partial(GymTaskEnv, task, render_mode)] * num_envs)


def _spec_of(task: Task) -> EnvSpec:
    """Return what Gymnasium needs to make a task; a task that can be named is recorded by its name."""
    return EnvSpec(
        id=task.env_id or task.name,
        entry_point="planspace.envs.task:TaskEnv",
        vector_entry_point="planspace.envs.vector:TaskVectorEnv",
        max_episode_steps=task.horizon,
        kwargs={"task": task.name if TASKS.get(task.name) is task else task},
    )
