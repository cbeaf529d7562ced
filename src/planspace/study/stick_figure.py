"""An episode as a stick figure: lines that a web page can animate."""

from typing import NamedTuple

import mujoco
import numpy as np

from planspace.demos.dataset import Demos

FRAMES = 60
"""Maximum number of poses of an episode."""
LONG = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
"""Shapes that are drawn as their axis. Boxes are drawn as their longest axis, other shapes as a point."""


class StickFilm(NamedTuple):
    """An episode as a stick figure."""

    seconds: float
    """Time between two poses."""
    poses: list[list[list[int]]]
    """[pose][line] as x0, y0, x1, y1 in mm."""


def stick_film(demos: Demos) -> StickFilm | None:
    """Project the first episode onto the two world axes along which its robot moves most.

    Returns:
        The film; None if no geom of the robot moves.
    """
    model, space = demos.info.compile()
    data = mujoco.MjData(model)
    episode = demos.episode(0)
    which = np.unique(np.linspace(0, len(episode.states) - 1, FRAMES).round().astype(int))
    moving = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] != 0]
    if not moving:
        return None
    poses = []
    for state in episode.states[which]:
        space.write_data(state, data)
        mujoco.mj_forward(model, data)
        poses.append([_ends(model, data, g) for g in moving])
    lines = np.array(poses)  # [pose, line, end, axis]
    spread = lines.reshape(-1, 3).std(axis=0)
    axes = sorted(np.argsort(-spread)[:2])
    flat = np.round(1000 * lines[..., axes]).astype(int)
    seconds = round(float(episode.times[-1]) / max(len(which) - 1, 1), 4)
    return StickFilm(seconds, flat.reshape(*flat.shape[:2], 4).tolist())


def _ends(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Both ends of a geom's axis, in world coordinates."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    reach = np.zeros(3)
    if kind in LONG:
        reach[2] = size[1]
    elif kind == int(mujoco.mjtGeom.mjGEOM_BOX):
        reach[size.argmax()] = size.max()
    reach = data.geom_xmat[geom].reshape(3, 3) @ reach
    return np.stack([data.geom_xpos[geom] - reach, data.geom_xpos[geom] + reach])
