"""A task as a Gymnasium environment, such as `planspace/CartPoleSwingUp-v0`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from planspace.envs.batch import TaskBatch
from planspace.envs.pixels import PixelStacks, find_view
from planspace.envs.render import RENDER_MODES, Renderer
from planspace.errors import UsageError, did_you_mean, unknown
from planspace.physics.pictures import PictureConfig
from planspace.physics.space import StateSpace
from planspace.tasks.catalog import find_task
from planspace.tasks.observation_types import ObservationType
from planspace.tasks.task import Task, find_reward_type

FIRST = np.zeros(1, dtype=int)
"""The only environment."""


class Described:
    """Names and units of the numbers in an environment's states and observations."""

    task: Task
    obs: ObservationType
    _batch: TaskBatch

    @property
    def state_fields(self) -> dict[str, str]:
        """Name and unit of each number of a planning state."""
        space = self._batch.simulator.space
        return dict(zip(space.names, space.units, strict=True))

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the numbers of a planning state."""
        return self._batch.simulator.space.names

    @property
    def obs_fields(self) -> dict[str, str]:
        """Name and unit of each number of an observation."""
        return self.task.fields(self.obs)


class TaskEnv(Described, gymnasium.Env[np.ndarray, np.ndarray], gymnasium.utils.EzPickle):
    """A single environment of a task.

    Observations are float32, or uint8 [height, width, 3 * frames] for pixels. `info["state"]` and the
    attribute `state` hold the planning state, which an embedding reads. `reset(options={"state": ...})`
    starts from a given state. As usual in Gymnasium, a copied or unpickled environment is a new one with the
    same arguments.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 25}  # noqa: RUF012  as Gymnasium does

    def __init__(
        self,
        task: str | Path | Task,
        obs: str = "raw",
        reward: str = "dense",
        render_mode: str | None = None,
        pictures: PictureConfig | None = None,
    ):
        """Make the environment; `gymnasium.make` and `planspace.make_env` call this.

        Args:
            task: the task's name, or a task of your own.
            obs: `raw`; `wrapped`: angles of unlimited hinges within (-pi, pi]; `trig`: raw plus their sine
                and cosine; `pixels`: the last pictures, stacked on the last axis, the oldest first.
            reward: `dense`: the task's reward; `sparse`: 1 at the goal and 0 elsewhere; `2020` (only the
                swing-up): the reward of the 2020 code, with controls without limits.
            render_mode: `human`, `rgb_array` or None.
            pictures: size, number and camera of the pictures, for `pixels`.

        Raises:
            UsageError: an argument has another value, or a task does not fit its model.
        """
        gymnasium.utils.EzPickle.__init__(self, task, obs, reward, render_mode, pictures)
        self.task = find_task(task) if isinstance(task, str | Path) else task
        self.obs, view = find_view(obs, pictures)
        self.render_mode = find_render_mode(render_mode, RENDER_MODES)
        self._batch = TaskBatch(self.task, 1, threads=1, reward=find_reward_type(reward, self.task))
        self.observation_space, self.action_space = spaces_of(self.task, self.obs, self._batch, view)
        self._pixels = None if view is None else PixelStacks(self._batch, view)
        self.metadata = {**self.metadata, "render_fps": frames_per_second(self._batch)}
        self._renderer = Renderer(self._batch)

    @property
    def state(self) -> np.ndarray:
        """The current planning state."""
        return self._batch.states[0].copy()

    @property
    def target(self) -> np.ndarray:
        """The target of the current episode; empty for a task without targets."""
        return self._batch.targets[0].copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: the seed of the environment's random stream; None continues the stream.
            options: `{"state": ...}` starts from a given planning state.

        Raises:
            UsageError: the given state has the wrong size, or is not finite, or `state` is misspelt.
        """
        options = checked_options(options, "state")
        super().reset(seed=seed)
        states, targets = self.task.sample_starts(1, self.np_random)
        if "state" in options:
            states = given_states(options["state"], self._batch.simulator.space)[None]
        self._batch.reset(states, targets)
        if self._pixels is not None:
            self._pixels.restart(FIRST, [self.np_random])
        if self.render_mode == "human":
            self._renderer.show(0)
        return self._now()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take one step; if the physics diverge, the episode is truncated and `info["diverged"]` is true.

        Raises:
            UsageError: the action has the wrong shape, or is not finite.
        """
        action = checked_actions(action, self.action_space)
        reward, terminated, diverged = self._batch.step(action[None])
        if self._pixels is not None:
            self._pixels.push(FIRST)
        obs, info = self._now(bool(diverged[0]))
        if self.render_mode == "human":
            self._renderer.show(0)
        return obs, float(reward[0]), bool(terminated[0]), bool(diverged[0]), info

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return an image [height, width, 3] if the render mode is `rgb_array`."""
        return self._renderer.picture(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window and free the graphics library."""
        self._renderer.close()
        if self._pixels is not None:
            self._pixels.close()

    def _now(self, diverged: bool = False) -> tuple[np.ndarray, dict[str, Any]]:
        info = {"state": self.state, "diverged": diverged}
        if self._pixels is not None:
            return self._pixels.stacks()[0], info
        obs = self.task.observe_as(self.obs, self._batch.states, self._batch.targets)
        return obs[0].astype(np.float32), info


def find_render_mode(name: str | None, known: Sequence[str]) -> str | None:
    """Return the render mode with this name, or None.

    Raises:
        UsageError: no render mode has this name.
    """
    if name is not None and name not in known:
        raise unknown("render mode", name, known)
    return name


def spaces_of(
    task: Task, obs: ObservationType, batch: TaskBatch, view: PictureConfig | None = None
) -> tuple[Box, Box]:
    """Return the observation space and the action space of one environment.

    Args:
        task: the task.
        obs: the type of its observation.
        batch: its simulations.
        view: the pictures that are observed instead; None for none.
    """
    low, high = batch.simulator.model.actuator_ctrlrange.T.astype(np.float32)
    actions = Box(low, high)
    if view is not None:
        return Box(0, 255, view.stack_shape, np.uint8), actions
    return Box(-np.inf, np.inf, (len(task.fields(obs)),), np.float32), actions


def frames_per_second(batch: TaskBatch) -> int:
    """Return the number of steps in a second of simulated time."""
    return round(
        1.0 / (batch.task.action_repeat * batch.task.frame_skip * batch.simulator.model.opt.timestep)
    )


def checked_options(options: dict[str, Any] | None, *known: str) -> dict[str, Any]:
    """Return the options of a reset, without None.

    Wrappers of other libraries pass options of their own, so only a name like one of ours is refused.

    Raises:
        UsageError: an option seems to be one of `known`, misspelt.
    """
    options = options or {}
    for name in options:
        if name not in known and did_you_mean(str(name), list(known)):
            raise unknown("option of reset", name, known)
    return options


def given_states(given: Any, space: StateSpace, num: int | None = None) -> np.ndarray:
    """Return the start states that a caller gave: one, or for `num` environments one each or one for all.

    Raises:
        UsageError: they have the wrong shape, are not finite, or hold a quaternion of length 0.
    """
    names = space.names
    try:
        states = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise UsageError(f"a start state must be numbers, got {given!r}.") from None
    shapes = [(len(names),)] + ([] if num is None else [(num, len(names))])
    if states.shape not in shapes:
        raise UsageError(f"a state has {len(names)} numbers ({', '.join(names)}), got shape {states.shape}.")
    if not np.isfinite(states).all():
        raise UsageError(f"a start state must be finite, got {states}.")
    for start in space.quaternion_columns:
        if (np.linalg.norm(states[..., start : start + 4], axis=-1) == 0).any():
            raise UsageError(
                f"a quaternion ({', '.join(names[start : start + 4])}) cannot be 0, got {states}."
            )
    states = space.normalise(states)
    return states if num is None else np.broadcast_to(states, (num, len(names)))


def checked_actions(actions: Any, space: gymnasium.Space[Any]) -> np.ndarray:
    """Return actions as float64; values outside the limits are clipped later.

    Raises:
        UsageError: they have another shape than the action space, or are not finite.
    """
    actions = np.asarray(actions, dtype=float)
    if actions.shape != space.shape:
        raise UsageError(f"an action must have shape {space.shape}, got {actions.shape}.")
    if not np.isfinite(actions).all():
        raise UsageError(f"an action must be finite numbers, got {actions}.")
    return actions
