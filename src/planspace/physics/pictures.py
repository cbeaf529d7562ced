"""Pictures of a robot: MuJoCo's renderer with an OpenGL backend that works here.

For encoders, what costs time and shows nothing new is off: shadows, reflections, sky, fog, haze and
antialiasing. All pictures of a process share one OpenGL context, because most drivers slow down or fail with
many.
"""

import atexit
import copy
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from planspace.errors import PlanspaceError, UsageError, check_setting, unknown
from planspace.physics.rendering import context_class, rendering_advice, rendering_backend
from planspace.physics.space import StateSpace

LEAST_SIZE, MOST_SIZE = 8, 1024
"""Limits of the width and height of a picture [pixels]."""
MOST_FRAMES = 16
"""Largest number of frames in a stack."""
OFF = ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE")
"""Effects that are not drawn."""
MOST_GEOMS = 10_000

Picture = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class PictureConfig:
    """What pictures look like, and how many of them make a stack."""

    width: int = 64
    """Width of a picture [pixels]."""
    height: int = 64
    """Height of a picture [pixels]."""
    frames: int = 3
    """Consecutive pictures in a stack, the oldest first. One picture shows no velocity."""
    camera: str = ""
    """Name of a camera of the model; by default its first one, or MuJoCo's free camera."""
    vary_colors: float = 0.0
    """Largest change of a colour between episodes, as a fraction of full brightness."""
    vary_camera: float = 0.0
    """Largest shift of the camera between episodes, as a fraction of the size of the model."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        size = f"from {LEAST_SIZE} to {MOST_SIZE}"
        for name, value in (("width", self.width), ("height", self.height)):
            check_setting(name, value, LEAST_SIZE <= value <= MOST_SIZE, size)
        check_setting("frames", self.frames, 1 <= self.frames <= MOST_FRAMES, f"from 1 to {MOST_FRAMES}")
        for name, value in (("vary_colors", self.vary_colors), ("vary_camera", self.vary_camera)):
            check_setting(name, value, 0 <= value <= 1, "from 0 to 1")

    @property
    def stack_shape(self) -> tuple[int, int, int]:
        """Shape of a stack: height, width, 3 channels for each frame."""
        return self.height, self.width, 3 * self.frames

    @property
    def varies(self) -> bool:
        """Whether colours or camera differ between episodes."""
        return self.vary_colors > 0 or self.vary_camera > 0


class Look(NamedTuple):
    """Colours and camera position of one episode, as differences from those of the model."""

    geoms: Float[np.ndarray, "geom 3"]
    materials: Float[np.ndarray, "material 3"]
    camera: Float[np.ndarray, " 3"]
    """Shift of the camera [m]."""


class Pictures:
    """Draws a model; a copy of it, so that changed colours do not reach the caller's model."""

    def __init__(
        self, model: mujoco.MjModel, space: StateSpace, config: PictureConfig, effects: bool = False
    ):
        """Open the renderer.

        Args:
            model: the compiled model.
            space: its state space.
            config: the settings.
            effects: draw shadows, reflections, sky, fog and haze, and smooth edges, for people.

        Raises:
            UsageError: the model has no camera of this name.
            PlanspaceError: no OpenGL backend works here; the message says what to install.
        """
        self.config, self.space = config, space
        self._model = _prepared(model, config, effects)
        self._data = mujoco.MjData(self._model)
        self._view = _find_view(self._model, config.camera)
        self._rgba = self._model.geom_rgba.copy(), self._model.mat_rgba.copy()
        self._position = self._model.cam_pos.copy(), self._view.lookat.copy()
        self._make_current = _shared_context(os.getpid())
        self._make_current()
        self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_50)
        self._scene = mujoco.MjvScene(self._model, maxgeom=MOST_GEOMS)
        for effect in () if effects else OFF:
            self._scene.flags[int(getattr(mujoco.mjtRndFlag, f"mjRND_{effect}"))] = 0
        self._rect = mujoco.MjrRect(0, 0, config.width, config.height)
        self._options = mujoco.MjvOption()

    def draw_look(self, rng: np.random.Generator) -> Look | None:
        """Draw the colours and the camera of an episode; None if the settings do not vary them."""
        if not self.config.varies:
            return None
        colors, model = self.config.vary_colors, self._model
        return Look(
            colors * rng.uniform(-1, 1, (model.ngeom, 3)),
            colors * rng.uniform(-1, 1, (model.nmat, 3)),
            self.config.vary_camera * model.stat.extent * rng.uniform(-1, 1, 3),
        )

    def of_states(
        self, states: Float[np.ndarray, "picture state"], look: Look | None = None
    ) -> UInt8[np.ndarray, "picture height width 3"]:
        """Draw states.

        Args:
            states: the states.
            look: colours and camera; None for those of the model.
        """
        pictures = np.empty((len(states), self.config.height, self.config.width, 3), dtype=np.uint8)
        for i, state in enumerate(self.space.normalise(np.asarray(states, dtype=float))):
            self.space.write_data(state, self._data)
            pictures[i] = self.of_pose(self._data.qpos, look=look)
        return pictures

    def of_pose(
        self,
        qpos: Float[np.ndarray, " qpos"],
        mocap: Float[np.ndarray, "body 3"] | None = None,
        look: Look | None = None,
    ) -> Picture:
        """Draw one pose.

        Args:
            qpos: the positions of all joints, as in MuJoCo.
            mocap: positions of the mocap bodies; None for those of the model.
            look: colours and camera; None for those of the model.
        """
        model, data = self._model, self._data
        self._apply(look)
        data.qpos[:] = qpos
        if mocap is not None:
            data.mocap_pos[:] = mocap
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_camlight(model, data)
        self._make_current()
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)  # another one may be bound
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, self._options, None, self._view, everything, self._scene)
        mujoco.mjr_render(self._rect, self._scene, self._context)
        picture = np.empty((self.config.height, self.config.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, self._rect, self._context)
        return picture[::-1]  # OpenGL counts rows from the bottom

    def close(self) -> None:
        """Free the memory of the graphics library."""
        self._make_current()
        self._context.free()

    def _apply(self, look: Look | None) -> None:
        if not self.config.varies and look is None:
            return
        model = self._model
        geoms, materials, shift = look or (0.0, 0.0, 0.0)
        model.geom_rgba[:, :3] = np.clip(self._rgba[0][:, :3] + geoms, 0, 1)
        model.mat_rgba[:, :3] = np.clip(self._rgba[1][:, :3] + materials, 0, 1)
        if self._view.type == mujoco.mjtCamera.mjCAMERA_FIXED:
            model.cam_pos[:] = self._position[0] + shift
        else:
            self._view.lookat[:] = self._position[1] + shift


def stacked(
    pictures: UInt8[np.ndarray, "*batch frame height width 3"],
) -> UInt8[np.ndarray, "*batch height width channel"]:
    """Lay the frames of stacks side by side on the last axis, the oldest first."""
    moved = np.moveaxis(pictures, -4, -2)
    return np.ascontiguousarray(moved.reshape(*moved.shape[:-2], -1))


def _prepared(model: mujoco.MjModel, config: PictureConfig, effects: bool) -> mujoco.MjModel:
    model = copy.copy(model)
    model.vis.global_.offwidth, model.vis.global_.offheight = config.width, config.height
    if not effects:
        model.vis.quality.offsamples = 0
        model.vis.quality.shadowsize = 0
    return model


def _find_view(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
    names = [model.camera(i).name for i in range(model.ncam)]
    view = mujoco.MjvCamera()
    if name and name not in names:
        if names:
            raise unknown("camera", name, names)
        raise UsageError("the model has no camera; leave out `camera`.")
    if not names:
        mujoco.mjv_defaultFreeCamera(model, view)
        return view
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED
    view.fixedcamid = names.index(name) if name else 0
    return view


@lru_cache(maxsize=1)
def _shared_context(pid: int) -> Callable[[], Any]:
    """Open the OpenGL context of this process, and return what makes it current."""
    backend = rendering_backend()
    if backend is None:
        raise PlanspaceError(f"pictures cannot be drawn: no OpenGL backend works here; {rendering_advice()}.")
    context = context_class(backend)(LEAST_SIZE, LEAST_SIZE)  # each renderer draws into a buffer of its own
    atexit.register(context.free)  # before Python unloads the graphics library
    return context.make_current
