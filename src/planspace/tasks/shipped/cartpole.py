"""Keep a pole upright on a cart.

States are (x, theta, xdot, thetadot) [m, rad, m/s, rad/s]; the pole is up at theta = 0.
"""

import numpy as np
from jaxtyping import Bool, Float

from planspace.mjcf.assets import ASSETS
from planspace.physics.angles import wrap
from planspace.tasks.task import Task

UPRIGHT = 0.1
"""The pole is upright if its angle is below this [rad]."""
FALLEN = 0.2
"""The pole has fallen if its angle is above this [rad]."""


def balance_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """Reward 1 for each step."""
    return np.ones(len(after))


def is_upright(states: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Return whether the pole is upright."""
    return np.abs(wrap(states[:, 1])) < UPRIGHT


def has_fallen(states: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Return whether the pole has fallen or the state is not finite."""
    return ~((np.abs(states[:, 1]) <= FALLEN) & np.isfinite(states).all(axis=1))


TASK = Task(
    name="cartpole",
    env_id="planspace/CartPole-v0",
    model=ASSETS / "cartpole.xml",
    joints=("slider", "hinge"),
    start_low=(-0.01,) * 4,
    start_high=(0.01,) * 4,
    horizon=100,
    frame_skip=2,
    reward=balance_reward,
    at_goal=is_upright,
    terminated=has_fallen,
    problem="cartpole",
    embedding_problem="cartpole-swingup",
    return_range=(0.0, 100.0),
    solved_return=95.0,
    similar_return=5.0,
    paper_order=1,
)
