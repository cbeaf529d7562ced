"""What the two reacher tasks share: a planar arm of two links whose fingertip is to reach a target.

States are two angles [rad] and their velocities [rad/s]; a target is a position [m]. The arm and its reward
are those of Gymnasium's Reacher.
"""

import numpy as np
from jaxtyping import Bool, Float

LINK = 0.1
"""Length of the first link [m]."""
TIP = 0.11
"""Distance of the fingertip from the second joint [m]."""
REACHED = 0.02
"""The target is reached if the fingertip is closer than this [m]."""
DISK = 0.2
"""Radius of the disk of targets [m]."""
JOINTS = ("joint0", "joint1")
START = (0.1, 0.1, 0.005, 0.005)
"""Episodes start within plus and minus this state."""
LAST_FIELDS = (
    ("target_x", "m"),
    ("target_y", "m"),
    ("joint0vel", "rad/s"),
    ("joint1vel", "rad/s"),
    ("to_target_x", "m"),
    ("to_target_y", "m"),
)
"""Name and unit of the numbers that both tasks observe."""


def fingertip(states: Float[np.ndarray, "env 4"]) -> Float[np.ndarray, "env 2"]:
    """Return the position of the fingertip [m]."""
    a, b = states[:, 0], states[:, 0] + states[:, 1]
    x = LINK * np.cos(a) + TIP * np.cos(b)
    return np.stack([x, LINK * np.sin(a) + TIP * np.sin(b)], axis=1)


def reach_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """Minus the fingertip's distance to the target before the step, minus 0.1 |u|^2."""
    return -_distance(before, target) - 0.1 * np.sum(control**2, axis=1)


def has_reached(states: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Return whether the fingertip is at the target."""
    return _distance(states, target) < REACHED


def draw_targets(num: int, rng: np.random.Generator) -> Float[np.ndarray, "env 2"]:
    """Draw positions uniformly from the disk."""
    angle = rng.uniform(-np.pi, np.pi, num)
    radius = DISK * np.sqrt(rng.uniform(0.0, 1.0, num))
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _distance(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.linalg.norm(fingertip(states) - target, axis=1)
