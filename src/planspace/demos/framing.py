"""A camera, a floor and light for a film, fitted to everything that the robot does in it."""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.physics.space import StateSpace

MAX_STATES = 200
"""Number of states from which the space of a motion is measured."""
MARGIN = 1.15
"""The camera is this many times as far away as needed."""
AZIMUTH_DEG, ELEVATION_DEG = 90.0, -12.0
"""Direction of the camera: it looks along y, a little downwards."""
FLOOR_RGBA = np.array([0.75, 0.78, 0.82, 1.0], dtype=np.float32)


@dataclass(frozen=True)
class Frame:
    """The space that the moving bodies of a robot use."""

    low: Float[np.ndarray, " 3"]
    """Lower corner [m]."""
    high: Float[np.ndarray, " 3"]
    """Upper corner [m]."""

    @classmethod
    def of_motion(
        cls, model: mujoco.MjModel, space: StateSpace, states: Float[np.ndarray, "time state"]
    ) -> "Frame":
        """Measure the space of a motion.

        Args:
            model: the compiled model.
            space: its state space.
            states: the states of the motion.
        """
        moving = np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0)
        shown = moving if len(moving) else np.arange(model.ngeom)
        radii = np.minimum(model.geom_rbound[shown], model.stat.extent)[:, None]
        data, corners = mujoco.MjData(model), []
        for state in states[:: max(1, len(states) // MAX_STATES)]:
            space.write_data(state, data)
            mujoco.mj_kinematics(model, data)
            centers = data.geom_xpos[shown]
            corners += [(centers - radii).min(axis=0), (centers + radii).max(axis=0)]
        if not len(shown):
            return cls(np.full(3, -0.5), np.full(3, 0.5))
        return cls(np.min(corners, axis=0), np.max(corners, axis=0))

    def camera(self, model: mujoco.MjModel, aspect: float) -> mujoco.MjvCamera:
        """Return a free camera that sees the whole motion.

        Args:
            model: the compiled model; gives the angle of view.
            aspect: width of the picture divided by its height.
        """
        camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, camera)
        half = np.tan(np.radians(float(model.vis.global_.fovy)) / 2)
        width, depth, height = (self.high - self.low) / 2
        camera.lookat[:] = (self.low + self.high) / 2
        camera.distance = MARGIN * (max(width / (half * aspect), height / half) + depth)
        camera.azimuth, camera.elevation = AZIMUTH_DEG, ELEVATION_DEG
        return camera

    def add_floor(self, scene: mujoco.MjvScene) -> None:
        """Draw a floor below the motion, for a model that has no plane."""
        center = [(self.low[0] + self.high[0]) / 2, (self.low[1] + self.high[1]) / 2, self.low[2]]
        floor = scene.geoms[scene.ngeom]
        size = np.array([50.0, 50.0, 0.1])
        kind = int(mujoco.mjtGeom.mjGEOM_PLANE)
        mujoco.mjv_initGeom(floor, kind, size, np.array(center), np.eye(3).ravel(), FLOOR_RGBA)
        scene.ngeom += 1


def light_from_camera(model: mujoco.MjModel) -> None:
    """Light the model from the camera, in addition to its own lights."""
    light = model.vis.headlight
    light.active, light.ambient[:], light.diffuse[:] = 1, 0.35, 0.55


def has_plane(model: mujoco.MjModel) -> bool:
    """Whether the model has a plane, such as a floor."""
    return bool((model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)).any())
