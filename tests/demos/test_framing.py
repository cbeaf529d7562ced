"""Films frame the whole motion, whatever the model has."""

import mujoco
import numpy as np
import pytest

from planspace.demos.framing import Frame, has_plane
from planspace.mjcf.compile import load_model
from planspace.physics.space import StateSpace

SLED = """<mujoco><worldbody>{more}<body><joint name="x" type="slide" axis="1 0 0" range="-9 9"/>
  <geom type="box" size="0.1 0.1 0.1"/></body></worldbody></mujoco>"""


def frame_of(states: np.ndarray, more: str = "") -> tuple[mujoco.MjModel, Frame]:
    model = load_model(SLED.format(more=more))
    return model, Frame.of_motion(model, StateSpace.from_model(model, ("x",)), states)


def test_the_frame_holds_every_state() -> None:
    """The box's bounding sphere has the radius 0.1 sqrt(3), at x from 1 to 5."""
    _, frame = frame_of(np.array([[5.0, 0.0], [1.0, 0.0]]))
    r = 0.1 * np.sqrt(3)
    np.testing.assert_allclose(frame.low, [1 - r, -r, -r])
    np.testing.assert_allclose(frame.high, [5 + r, r, r])


def test_the_camera_sees_both_ends() -> None:
    """Half the angle of view is 22.5 degrees upwards, so its tangent is 0.414, and 4/3 of that sideways."""
    model, frame = frame_of(np.array([[5.0, 0.0], [1.0, 0.0]]))
    camera = frame.camera(model, 4 / 3)
    np.testing.assert_allclose(camera.lookat, [3.0, 0.0, 0.0])
    assert camera.distance * 0.414 * 4 / 3 > 2.1  # half of the width, in the plane of the motion


def test_a_floor_is_drawn_only_for_a_model_without_a_plane() -> None:
    model, frame = frame_of(np.zeros((1, 2)))
    assert not has_plane(model)
    assert has_plane(frame_of(np.zeros((1, 2)), '<geom type="plane" size="1 1 1"/>')[0])
    scene = mujoco.MjvScene(model, maxgeom=10)
    frame.add_floor(scene)
    assert scene.ngeom == 1 and scene.geoms[0].pos[2] == pytest.approx(frame.low[2])
