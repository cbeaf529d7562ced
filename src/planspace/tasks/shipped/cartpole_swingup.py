"""Swing the pole of a cart up and keep it upright. States are those of `cartpole`."""

import numpy as np
from jaxtyping import Float

from planspace.mjcf.assets import ASSETS
from planspace.physics.angles import wrap
from planspace.tasks.shipped.cartpole import UPRIGHT, is_upright
from planspace.tasks.task import Task


def swing_up_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """-|theta| - 0.1 u^2, plus 1 while upright, of the state after the step."""
    return -np.abs(wrap(after[:, 1])) - 0.1 * np.sum(control**2, axis=1) + is_upright(after, target)


def swing_up_reward_2020(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """The same, but the bonus is paid on half the circle: wherever theta < 0.1.

    Source: 2020 `cartpole_env.py`.
    """
    theta = wrap(after[:, 1])
    return -np.abs(theta) - 0.1 * np.sum(control**2, axis=1) + (theta < UPRIGHT)


TASK = Task(
    name="cartpole-swingup",
    env_id="planspace/CartPoleSwingUp-v0",
    model=ASSETS / "cartpole.xml",
    joints=("slider", "hinge"),
    start_low=(-0.1, -3.14, -0.1, -0.5),
    start_high=(0.1, 3.14, 0.1, 0.5),
    horizon=200,
    frame_skip=2,
    reward=swing_up_reward,
    reward_2020=swing_up_reward_2020,
    at_goal=is_upright,
    problem="cartpole-swingup",
    return_range=(-600.0, 100.0),
    solved_return=0.0,
    similar_return=50.0,
    paper_order=2,
)
