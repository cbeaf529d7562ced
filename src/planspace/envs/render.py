"""Draws episodes, as images or in a window."""

from typing import Any

import mujoco
import numpy as np

from planspace.envs.batch import TaskBatch
from planspace.errors import PlanspaceError
from planspace.physics.pictures import PictureConfig, Pictures

SIZE = PictureConfig(width=640, height=480)
RENDER_MODES = ("human", "rgb_array")


class Renderer:
    """Draws the episodes of a batch; the graphics library is loaded with the first image."""

    def __init__(self, batch: TaskBatch):
        """Remember the batch; nothing is opened before the first image."""
        self._batch = batch
        self._offscreen: Pictures | None = None
        self._window: Any = None  # mujoco.viewer's handle
        self._shown: mujoco.MjData | None = None

    def picture(self, episode: int) -> np.ndarray:
        """Return an image of an episode [height, width, 3].

        Raises:
            PlanspaceError: no OpenGL backend works here; the message says what to install.
        """
        simulator = self._batch.simulator
        if self._offscreen is None:
            self._offscreen = Pictures(simulator.model, simulator.space, SIZE, effects=True)
        data = self._batch.mujoco_data(episode)
        return np.ascontiguousarray(self._offscreen.of_pose(data.qpos, data.mocap_pos))

    def show(self, episode: int) -> None:
        """Show the current state of an episode in a window.

        Raises:
            PlanspaceError: a window cannot be opened.
        """
        now = self._batch.mujoco_data(episode)
        if self._window is None:
            self._shown = now
            try:
                from mujoco import viewer  # imports the window system

                self._window = viewer.launch_passive(
                    self._batch.simulator.model, now, show_left_ui=False, show_right_ui=False
                )
            except Exception as error:  # any error of the window system
                raise PlanspaceError(
                    f"cannot open a window here ({error}); render_mode='rgb_array' works without one."
                ) from error
        assert self._shown is not None
        with self._window.lock():
            self._shown.qpos[:], self._shown.qvel[:], self._shown.act[:] = now.qpos, now.qvel, now.act
            self._shown.mocap_pos[:] = now.mocap_pos
            mujoco.mj_forward(self._batch.simulator.model, self._shown)
        self._window.sync()

    def close(self) -> None:
        """Close the window and free the graphics library."""
        if self._offscreen is not None:
            self._offscreen.close()
        if self._window is not None:
            self._window.close()
        self._offscreen = self._window = self._shown = None
