"""Small pictures of a robot."""

import numpy as np
import pytest

import planspace
from planspace.demos.dataset import Demos
from planspace.errors import PlanspaceError, UsageError
from planspace.physics import pictures as module
from planspace.physics.pictures import PictureConfig, Pictures, stacked
from planspace.tasks.catalog import find_task

SMALL = PictureConfig(width=32, height=24, frames=2)


def cart_column(picture: np.ndarray) -> float:
    """Where the blue cart is, from 0 at the left edge to 1 at the right edge."""
    r, g, b = (picture[..., i].astype(int) for i in range(3))
    columns = np.nonzero((b - r > 30) & (b - g > 15))[1]
    assert len(columns)
    return columns.mean() / picture.shape[1]


def test_pictures_show_where_the_cart_is(opengl: str) -> None:
    model, space = find_task("cartpole-swingup").compile()
    states = np.array([[-0.8, 0, 0, 0], [0.8, 0, 0, 0], [0.8, 2 * np.pi, 0, 0]])
    shown = Pictures(model, space, SMALL).of_states(states)
    assert shown.shape == (3, 24, 32, 3) and shown.dtype == np.uint8
    assert cart_column(shown[0]) < 0.35 and cart_column(shown[1]) > 0.65
    np.testing.assert_array_equal(shown[1], shown[2])


def test_stacks_have_the_oldest_frame_first() -> None:
    frames = np.arange(2 * 3)[:, None, None, None].repeat(3, axis=-1).reshape(2, 3, 1, 1, 3)
    assert stacked(frames.astype(np.uint8))[1, 0, 0].tolist() == [3, 3, 3, 4, 4, 4, 5, 5, 5]


def test_looks_vary_and_the_model_does_not(opengl: str) -> None:
    model, space = find_task("cartpole-swingup").compile()
    before = model.geom_rgba.copy()
    varied = Pictures(model, space, PictureConfig(vary_colors=0.3, vary_camera=0.1))
    plain, state = Pictures(model, space, PictureConfig()), np.zeros((1, 4))
    look = varied.draw_look(np.random.default_rng(0))
    assert (varied.of_states(state, look) != plain.of_states(state)).mean() > 0.01
    np.testing.assert_array_equal(varied.of_states(state), plain.of_states(state))
    np.testing.assert_array_equal(model.geom_rgba, before)


def test_states_of_demonstrations_are_drawn(opengl: str, demos: Demos) -> None:
    shown = demos.render_states(np.array([3, 0]), SMALL)
    np.testing.assert_array_equal(shown[1], demos.render_states(np.array([0]), SMALL)[0])
    with pytest.raises(UsageError, match="`rows` must be row numbers from 0 to"):
        demos.render_states(np.array([len(demos.states)]))


def test_without_a_backend_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "rendering_backend", lambda: None)
    monkeypatch.setenv("MUJOCO_GL", "nothing")
    module._shared_context.cache_clear()
    env = planspace.make_env("cartpole-swingup", obs="pixels")
    with pytest.raises(
        PlanspaceError, match="no OpenGL backend works here; unset MUJOCO_GL, which is set to"
    ):
        env.reset(seed=0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"width": 4}, "`width` must be from 8 to 1024, got 4"),
        ({"frames": 0}, "`frames` must be from 1 to 16, got 0"),
        ({"vary_colors": 2.0}, "`vary_colors` must be from 0 to 1, got 2.0"),
    ],
)
def test_wrong_settings_are_refused(given: dict, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        PictureConfig(**given)
