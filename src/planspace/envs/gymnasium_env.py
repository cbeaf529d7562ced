"""The environment of a `GymTask`: flat observations, clipped actions, and a planning state."""

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, flatten
from jaxtyping import Float

from planspace.errors import PlanspaceError
from planspace.tasks.env_state import JointReader, state_reader
from planspace.tasks.gymnasium import GymTask

if TYPE_CHECKING:  # it imports MuJoCo, which an environment may do without
    from planspace.physics.space import StateSpace

STATE_TOLERANCE = 1e-6
"""Difference between a state that was set and the state that is then read."""
DEFAULT_FPS = 30
"""Steps in a second, for an environment that does not say how long a step lasts."""


class GymTaskEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One environment of a `GymTask`, with the interface of `TaskEnv`.

    Observations are flat and float32. `info["state"]` and the attribute `state` hold the planning state,
    which an embedding reads; `state_names` names its numbers. If the environment raises an exception or
    returns a number that is not finite, a `PlanspaceError` names the environment.
    """

    def __init__(self, task: GymTask, render_mode: str | None = None):
        """Make the environment.

        Args:
            task: the task.
            render_mode: a render mode of the environment, or None.

        Raises:
            UsageError: the environment cannot be made, or policies cannot be trained on it.
        """
        self.task = task
        sizes = task.sizes
        self.inner = task.make(render_mode)
        self.render_mode, self.metadata = render_mode, self.inner.metadata
        self.state_names = task.state_names
        self.observation_space = Box(-np.inf, np.inf, (len(sizes.obs_names),), np.float32)
        self.action_space = Box(sizes.action_low, sizes.action_high, dtype=sizes.action_low.dtype.type)
        self._reader = reader = state_reader(self.inner)
        self._columns = [reader.names.index(name) for name in sizes.other_names] if reader else []
        self.state = np.zeros(len(self.state_names))

    @property
    def step_time(self) -> float:
        """Duration of a step [s]."""
        step = getattr(self.inner.unwrapped, "dt", None)  # Gymnasium's MuJoCo environments have it
        if isinstance(step, int | float) and step > 0:
            return float(step)
        return 1.0 / (self.metadata.get("render_fps") or DEFAULT_FPS)

    @property
    def joint_space(self) -> "StateSpace | None":
        """State space of the MuJoCo joints, whose numbers come first in what is set; None without them."""
        return self._reader.space if isinstance(self._reader, JointReader) else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode.

        Raises:
            PlanspaceError: the environment fails, or is not in the state that `options["state"]` asks for.
        """
        try:
            obs, info = self.inner.reset(seed=seed, options=options)
        except Exception as error:  # whatever the environment raises
            raise self._failure("reset", error) from error
        if options and "state" in options:
            self._check_state(options["state"])
        return self._read(obs), {**info, "state": self.state.copy()}

    def set_state(self, values: Float[np.ndarray, " settable"]) -> np.ndarray:
        """Put the environment, whose episode has just started, into another state.

        Args:
            values: the numbers `task.sizes.settable_names`.

        Returns:
            The observation, flat and float32.

        Raises:
            PlanspaceError: the environment fails, or is then in another state.
        """
        assert self._reader is not None
        try:
            obs = self._reader.write(values)
        except Exception as error:  # whatever the environment raises
            raise self._failure("set_state", error) from error
        self._check_state(values)
        return self._read(obs)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take one step with the action clipped to its limits.

        Raises:
            PlanspaceError: the environment fails, or returns a number that is not finite.
        """
        space = self.inner.action_space
        clipped = np.clip(action, self.action_space.low, self.action_space.high)
        try:
            obs, reward, terminated, truncated, info = self.inner.step(
                clipped.astype(space.dtype).reshape(space.shape)  # pyright: ignore[reportArgumentType]
            )
            reward = float(reward)
        except Exception as error:  # whatever the environment raises
            raise self._failure("step", error) from error
        flat = self._read(obs)
        if not np.isfinite(reward):
            raise PlanspaceError(f"{self.task.name} returned a reward that is not finite ({reward}).")
        return flat, reward, bool(terminated), bool(truncated), {**info, "state": self.state.copy()}

    def render(self) -> Any:
        """Return what the environment draws.

        Raises:
            PlanspaceError: it cannot be drawn here.
        """
        try:
            return self.inner.render()
        except Exception as error:  # any error of the graphics library
            raise self._failure("render", error) from error

    def close(self) -> None:
        """Close the environment."""
        self.inner.close()

    def _check_state(self, values: Float[np.ndarray, " settable"]) -> None:
        """Check that the environment is in a state.

        Raises:
            PlanspaceError: it is not, or its state is not known.
        """
        if self._reader is None:
            raise PlanspaceError(f"{self.task.name} cannot start an episode at a given state: it has none.")
        found = self._reader()
        if found.shape != np.shape(values):
            raise PlanspaceError(
                f"the state of {self.task.name} has {len(found)} numbers, got {np.size(values)} to start at."
            )
        if not np.allclose(found, values, rtol=0, atol=STATE_TOLERANCE):
            worst = int(np.argmax(np.abs(found - values)))
            raise PlanspaceError(
                f"{self.task.name} cannot start an episode at a given state: {self._reader.names[worst]} was "
                f"set to {values[worst]:g} and is {found[worst]:g}."
            )

    def _read(self, obs: Any) -> np.ndarray:
        """Update the state, and return the flat observation."""
        flat = np.asarray(flatten(self.inner.observation_space, obs), dtype=float)
        columns = self._columns
        self.state = np.append(flat, self._reader()[columns]) if self._reader and columns else flat
        if not np.isfinite(self.state).all():
            name = self.state_names[int(np.argmin(np.isfinite(self.state)))]
            raise PlanspaceError(f"{self.task.name} returned a number that is not finite: {name}.")
        return flat.astype(np.float32)

    def _failure(self, method: str, error: Exception) -> PlanspaceError:
        problem = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return PlanspaceError(f"{self.task.name} failed in `{method}`: {problem}")
