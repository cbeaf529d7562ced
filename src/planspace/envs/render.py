"""Pictures of an episode, and a window on it."""

from typing import Any

import mujoco
import numpy as np

from planspace.envs.batch import TaskBatch
from planspace.errors import PlanspaceError

SIZE = (480, 640)
RENDER_MODES = ("human", "rgb_array")


class Renderer:
    """Draws the episodes of a batch; needs a graphics library, which is loaded with the first picture."""

    def __init__(self, batch: TaskBatch):
        """Nothing is opened before something is drawn."""
        self._batch = batch
        self._offscreen: mujoco.Renderer | None = None
        self._window: Any = None  # mujoco.viewer's handle
        self._shown: mujoco.MjData | None = None

    def picture(self, episode: int) -> np.ndarray:
        """The picture of an episode now [height, width, 3].

        Raises:
            PlanspaceError: there is nothing to draw with.
        """
        if self._offscreen is None:
            try:
                self._offscreen = mujoco.Renderer(self._batch.simulator.model, *SIZE)
            except Exception as error:  # whatever the graphics library raises
                raise PlanspaceError(
                    f"no picture can be drawn here ({error}); try MUJOCO_GL=egl, or see `planspace doctor`."
                ) from error
        self._offscreen.update_scene(self._batch.mujoco_data(episode), camera=0)
        return self._offscreen.render()

    def show(self, episode: int) -> None:
        """Shows an episode as it is now in a window.

        Raises:
            PlanspaceError: no window can be opened.
        """
        now = self._batch.mujoco_data(episode)
        if self._window is None:
            self._shown = now
            try:
                from mujoco import viewer  # brings the window system with it

                self._window = viewer.launch_passive(
                    self._batch.simulator.model, now, show_left_ui=False, show_right_ui=False
                )
            except Exception as error:  # whatever the window system raises
                raise PlanspaceError(
                    f"no window can be opened here ({error}); render_mode='rgb_array' needs none."
                ) from error
        assert self._shown is not None
        with self._window.lock():
            self._shown.qpos[:], self._shown.qvel[:] = now.qpos, now.qvel
            self._shown.mocap_pos[:] = now.mocap_pos
            mujoco.mj_forward(self._batch.simulator.model, self._shown)
        self._window.sync()

    def close(self) -> None:
        """Frees what was opened."""
        if self._offscreen is not None:
            self._offscreen.close()
        if self._window is not None:
            self._window.close()
        self._offscreen = self._window = self._shown = None
