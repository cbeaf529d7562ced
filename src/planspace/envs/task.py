"""The tasks as Gymnasium environments: `planspace/CartPoleSwingUp-v0` and its siblings."""

from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box

from planspace.envs.batch import TaskBatch
from planspace.errors import UsageError
from planspace.tasks import ObsForm, find_task

RENDER_SIZE = (480, 640)


class TaskEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One episode of a task at a time.

    Observations are float32; `info["state"]` and the attribute `state` hold the planning state, which is
    what an embedding reads. `reset(options={"state": ...})` starts from a given state.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012  Gymnasium's way

    def __init__(self, task: str, obs: ObsForm = "raw", render_mode: str | None = None):
        """Makes the environment; `gymnasium.make` calls this.

        Args:
            task: the task's command-line name.
            obs: `raw`, or `trig`: raw with sin and cos of its angles.
            render_mode: `rgb_array` or None.
        """
        self.task = find_task(task)
        self.render_mode = render_mode
        self._batch = TaskBatch(self.task, 1, threads=1)
        simulator = self._batch.simulator
        self._observe = self.task.observe if obs == "raw" else self.task.observe_trig
        size = self._observe(self._batch.states, self._batch.targets).shape[1]
        self.observation_space = Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = Box(
            simulator.control_low.astype(np.float32), simulator.control_high.astype(np.float32)
        )
        self._renderer: mujoco.Renderer | None = None

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the numbers of `state`."""
        return self._batch.simulator.space.names

    @property
    def state(self) -> np.ndarray:
        """The planning state now."""
        return self._batch.states[0].copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: restarts the environment's random stream.
            options: `{"state": ...}` starts from a given planning state.

        Raises:
            UsageError: the given state has another size.
        """
        super().reset(seed=seed)
        states, targets = self.task.sample_starts(1, self.np_random)
        if options and "state" in options:
            state = np.asarray(options["state"], dtype=float)
            if state.shape != states.shape[1:]:
                raise UsageError(f"a state has {states.shape[1]} numbers, options give {state.shape}.")
            states = state[None]
        self._batch.reset(states, targets)
        return self._now()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Takes one step; diverged physics truncate the episode, with `info["diverged"]`."""
        reward, terminated, diverged = self._batch.step(np.asarray(action, dtype=float)[None])
        obs, info = self._now()
        if diverged[0]:
            info["diverged"] = True
        return obs, float(reward[0]), bool(terminated[0]), bool(diverged[0]), info

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The picture now [height, width, 3], where the mode is `rgb_array`."""
        if self.render_mode != "rgb_array":
            return None
        model = self._batch.simulator.model
        if self._renderer is None:
            self._renderer = mujoco.Renderer(model, *RENDER_SIZE)
        data = self._batch.simulator.mujoco_data(0)
        if self.task.has_target:
            data.mocap_pos[0, :2] = self._batch.targets[0]
            mujoco.mj_forward(model, data)
        self._renderer.update_scene(data, camera=0)
        return self._renderer.render()

    def close(self) -> None:
        """Frees the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _now(self) -> tuple[np.ndarray, dict[str, Any]]:
        obs = self._observe(self._batch.states, self._batch.targets)[0].astype(np.float32)
        return obs, {"state": self.state}
