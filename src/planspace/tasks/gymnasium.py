"""Any Gymnasium environment as a task: `gym:Hopper-v5` on the command line, `GymTask("Hopper-v5")` in Python.

planspace makes such an environment with `gymnasium.make` and only steps it; it has no goal and no planning
problem. The state of the task, in which an embedding finds its inputs by name, is the observation, followed
by the attribute `state` of the environment, or by the positions and velocities of its MuJoCo joints.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from jaxtyping import Float

from planspace.errors import UsageError, check_whole, quoted
from planspace.tasks.catalog import GYM_PREFIX, find_task
from planspace.tasks.env_state import state_reader
from planspace.tasks.gymnasium_ids import provider_versions, registered_id
from planspace.tasks.observation_types import MAX_OBS, ObservationType, RewardType
from planspace.tasks.source_hash import function_settings
from planspace.tasks.task import Task

PAGE = "docs/howto/gymnasium-task.md"
"""The how-to page that messages point to."""


class Sizes(NamedTuple):
    """Names and limits that are read from an environment."""

    obs_names: tuple[str, ...]
    other_names: tuple[str, ...]
    """Numbers of the state that are not observed under their names; see `tasks.env_state`."""
    action_low: Float[np.ndarray, " action"]
    action_high: Float[np.ndarray, " action"]
    horizon: int
    settable_names: tuple[str, ...]
    """Numbers of the state that `GymTaskEnv.set_state` sets; none if it cannot be set."""


@dataclass(frozen=True, repr=False)
class GymTask:
    """A Gymnasium environment as a task."""

    id: str
    """Its id, such as `Hopper-v5`. If it has the form MODULE:NAME, Gymnasium imports the module first."""
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of its constructor, which `gymnasium.make` passes on."""
    max_episode_steps: int | None = None
    """Steps of an episode before it is truncated; None uses the limit that the id was registered with."""
    obs_names: tuple[str, ...] = ()
    """Name of each number of the flat observation. The default is `obs_0`, `obs_1`, ...; the entry `key` of a
    dictionary has `key_0`, `key_1`, ..."""

    def __post_init__(self) -> None:
        """Check the types.

        Raises:
            UsageError: a value has another type.
        """
        steps, names = self.max_episode_steps, self.obs_names
        if not isinstance(self.id, str) or not self.id:
            raise UsageError(f"the id of a GymTask must be text such as 'Hopper-v5', got {quoted(self.id)}.")
        if not isinstance(self.kwargs, Mapping):
            raise UsageError(f"`kwargs` must be a mapping of names to values, got {quoted(self.kwargs)}.")
        if steps is not None:
            check_whole("max_episode_steps", steps)
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            raise UsageError(f"`obs_names` must be a list of names, got {quoted(names)}.")
        object.__setattr__(self, "obs_names", tuple(names))

    def __repr__(self) -> str:
        """Return the id and the arguments."""
        return f"GymTask({self.id!r}, {dict(self.kwargs)!r})" if self.kwargs else f"GymTask({self.id!r})"

    @property
    def name(self) -> str:
        """Its name on the command line."""
        return GYM_PREFIX + self.id

    @property
    def horizon(self) -> int:
        """Steps of an episode before it is truncated."""
        return self.sizes.horizon

    @property
    def reward_types(self) -> tuple[RewardType, ...]:
        """The reward types that the task has: only the reward of the environment."""
        return ("dense",)

    @property
    def obs_types(self) -> tuple[ObservationType, ...]:
        """The observation types that the task has: only the observation of the environment."""
        return ("raw",)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Name of each number of the state: the observation, then the state of the environment or joints."""
        return (*self.sizes.obs_names, *self.sizes.other_names)

    @property
    def state_units(self) -> tuple[str, ...]:
        """Unit of each number of the state: none is known."""
        return ("",) * len(self.state_names)

    def fields(self, obs_type: ObservationType) -> dict[str, str]:
        """Return the name and unit of each number of an observation, in order; units are not known."""
        return dict.fromkeys(self.sizes.obs_names, "")

    def observe_as(
        self,
        obs_type: ObservationType,
        states: Float[np.ndarray, "env state"],
        targets: Float[np.ndarray, "env target"],
    ) -> Float[np.ndarray, "env obs"]:
        """Return the observations, which are the first numbers of the states."""
        return states[:, : len(self.sizes.obs_names)]

    def plain(self) -> dict[str, Any]:
        """Describe the task as plain data, as a run records it."""
        return {
            "id": self.id,
            "kwargs": _for_json(function_settings(self.kwargs)),
            "max_episode_steps": self.max_episode_steps,
            "obs_names": list(self.obs_names),
        }

    @property
    def versions(self) -> dict[str, str]:
        """Versions of Gymnasium and of the packages that provide the environment."""
        return provider_versions(self.registered_id)

    def make(self, render_mode: str | None = None) -> gymnasium.Env[Any, Any]:
        """Make one environment.

        Args:
            render_mode: a render mode of the environment, or None.

        Raises:
            UsageError: Gymnasium does not know the id, or the environment cannot be made.
            PlanspaceError: a package is missing.
        """
        env_id, arguments = self.registered_id, dict(self.kwargs)
        if self.max_episode_steps is not None:
            arguments["max_episode_steps"] = self.max_episode_steps
        if render_mode is not None:
            arguments["render_mode"] = render_mode
        try:
            return gymnasium.make(env_id, disable_env_checker=True, **arguments)
        except Exception as error:  # whatever the constructor raises
            problem = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise UsageError(f"{self.name} cannot be made: {problem}") from error

    @cached_property
    def sizes(self) -> Sizes:
        """Names and limits, read from an environment that is made for this.

        Raises:
            UsageError: its spaces are not continuous, it has no time limit, or it cannot be made.
            PlanspaceError: a package is missing.
        """
        env = self.make()
        try:
            low, high = self._action_limits(env.action_space)
            names = self._checked_names(tuple(_flat_names(self.name, env.observation_space)))
            reader = state_reader(env)
            others = [name for name in (reader.names if reader else ()) if name not in names]
            settable = reader.names if reader and reader.can_write else ()
            return Sizes(names, tuple(others), low, high, self._horizon(env), settable)
        finally:
            env.close()

    @cached_property
    def registered_id(self) -> str:
        """The id under which Gymnasium has it.

        Raises:
            UsageError: Gymnasium does not know the id.
            PlanspaceError: a package is missing.
        """
        return registered_id(self.id, self.name)

    def _action_limits(self, actions: gymnasium.Space[Any]) -> tuple[np.ndarray, np.ndarray]:
        if not isinstance(actions, Box) or not np.issubdtype(actions.dtype, np.floating):
            raise UsageError(
                f"{self.name} has the actions {actions}; policies can be trained only on a Box of floats."
            )
        low, high = actions.low.ravel(), actions.high.ravel()
        if not (low < high).all():
            raise UsageError(f"{self.name} has an action whose limits are equal: {actions}.")
        return low, high

    def _checked_names(self, default: tuple[str, ...]) -> tuple[str, ...]:
        names = self.obs_names or default
        if len(names) != len(default) or len(set(names)) != len(names):
            wanted = f"{len(default)} different names, one for each number"
            raise UsageError(f"{self.name}: `obs_names` must be {wanted}, got {quoted(names)}.")
        if not 0 < len(names) <= MAX_OBS:
            raise UsageError(f"{self.name} observes {len(names)} numbers; at most {MAX_OBS} are supported.")
        return names

    def _horizon(self, env: gymnasium.Env[Any, Any]) -> int:
        limit = env.spec.max_episode_steps if env.spec else None
        if limit is None:
            limit = getattr(env.unwrapped, "_step_limit", None)  # dm_control's environments end by themselves
        if limit is None or not 1 <= limit < math.inf:
            raise UsageError(
                f"{self.name} has no time limit: set `max_episode_steps` of a GymTask. See {PAGE}."
            )
        return math.ceil(limit)


AnyTask = Task | GymTask
"""What policies are trained on."""


def find_training_task(task: str | Path | AnyTask) -> AnyTask:
    """Return what policies are trained on: what `find_task` finds, or a Gymnasium environment (`gym:ID`).

    Raises:
        UsageError: no task has this name.
        PlanspaceError: a problem file or its model cannot be read.
    """
    if isinstance(task, GymTask):
        return task
    if isinstance(task, str) and task.startswith(GYM_PREFIX):
        return GymTask(task.removeprefix(GYM_PREFIX))
    return find_task(task)


def parse_gym_task(plain: Any) -> GymTask | None:
    """Build the task that `GymTask.plain` described in a file, which may come from someone else.

    Returns:
        The task; None if its id names a module, or an argument is neither a number nor a list of numbers,
        because then it could run code or read files. The user must pass such a task.

    Raises:
        TypeError: the description has fields of the wrong type.
        ValueError: a field has a value that is not allowed.
    """
    if not isinstance(plain, dict) or not isinstance(plain.get("id"), str):
        raise TypeError("its Gymnasium environment has no id")
    kwargs, names, limit = plain.get("kwargs"), plain.get("obs_names"), plain.get("max_episode_steps")
    if not isinstance(kwargs, dict) or not isinstance(names, list) or not isinstance(limit, int | None):
        raise TypeError("the description of its Gymnasium environment has fields of the wrong type")
    numbers = [n for value in kwargs.values() for n in (value if isinstance(value, list) else [value])]
    only_numbers = all(number is None or isinstance(number, bool | int | float) for number in numbers)
    if not only_numbers or not re.fullmatch(r"(?:[\w-]+/)?[\w.-]+", plain["id"]):
        return None
    try:
        return GymTask(plain["id"], kwargs, limit, tuple(map(str, names)))
    except UsageError as error:
        raise ValueError(str(error)) from error


def _for_json(value: Any) -> Any:
    """Plain data with text for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {name: _for_json(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_for_json(item) for item in value]
    return value if not isinstance(value, float) or math.isfinite(value) else repr(value)


def _flat_names(task: str, space: gymnasium.Space[Any], prefix: str = "") -> Iterator[str]:
    """Names of the numbers of an observation, in the order of `gymnasium.spaces.flatten`."""
    if isinstance(space, Box):
        yield from (f"{prefix or 'obs'}_{i}" for i in range(math.prod(space.shape)))
    elif isinstance(space, Dict):
        for key, entry in space.spaces.items():
            yield from _flat_names(task, entry, f"{prefix}_{key}" if prefix else str(key))
    else:
        raise UsageError(f"{task} observes {space}; only a Box, or a Dict of Boxes, is supported.")
