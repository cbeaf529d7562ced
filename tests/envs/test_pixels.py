"""Pictures as observations of tasks."""

import numpy as np
import pytest

import planspace
from planspace.errors import UsageError
from planspace.physics.pictures import PictureConfig

SMALL = PictureConfig(width=16, height=12, frames=3)


def test_a_single_environment_stacks_frames(opengl: str) -> None:
    env = planspace.make_env("cartpole-swingup", obs="pixels", pictures=SMALL)
    start, _ = env.reset(seed=0)
    assert env.observation_space.contains(start) and start.shape == (12, 16, 9)
    np.testing.assert_array_equal(start[..., :3], start[..., 6:])  # the first picture fills the stack
    first, *_ = env.step(np.full(1, 3.0))
    second, *_ = env.step(np.full(1, 3.0))
    np.testing.assert_array_equal(first[..., 3:6], start[..., 6:])
    np.testing.assert_array_equal(second[..., :6], first[..., 3:])
    assert (second[..., 6:] != first[..., 6:]).any()
    env.close()


def test_a_vector_environment_gives_the_same(opengl: str) -> None:
    """Also where an episode ends and the next one begins, with colours of its own."""
    config = PictureConfig(width=16, height=12, frames=2, vary_colors=0.3)
    envs = planspace.make_env("cartpole-swingup", 2, obs="pixels", pictures=config, max_episode_steps=2)
    alone = planspace.make_env("cartpole-swingup", obs="pixels", pictures=config)
    seen = [envs.reset(seed=[5, 6])[0]] + [envs.step(np.zeros((2, 1)))[0] for _ in range(3)]
    expected = [alone.reset(seed=6)[0]] + [alone.step(np.zeros(1))[0] for _ in range(2)]
    expected.append(alone.reset()[0])
    assert envs.observation_space.contains(seen[0])
    np.testing.assert_array_equal(np.stack(seen)[:, 1], np.stack(expected))
    envs.close(), alone.close()


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(UsageError, match="`pictures` describes the observation 'pixels', got obs='raw'"):
        planspace.make_env("cartpole-swingup", pictures=SMALL)
    with pytest.raises(UsageError, match="unknown observation type 'pixel'. Did you mean 'pixels'"):
        planspace.make_env("cartpole-swingup", obs="pixel")
