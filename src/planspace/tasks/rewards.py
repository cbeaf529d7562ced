"""What the tasks pay, when their goals are reached, and when they end; all over batches, as in `tasks`."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from planspace.mjcf.compile import ASSETS, load_model
from planspace.physics.angles import wrap
from planspace.physics.space import StateSpace

UPRIGHT = 0.1
"""A pole stands when its angle is below this [rad]; from `FALLEN` on it has fallen."""
FALLEN = 0.2
LINK = 0.1
"""Length of the reacher's first link [m]."""
TIP = 0.11
"""From the reacher's second joint to its fingertip [m]."""
REACHED = 0.02
"""The reacher is at its target when its fingertip is so near [m]."""
FAR = 5.0
"""A pose that is farther away than this costs no more."""


def never(states: np.ndarray) -> Bool[np.ndarray, " env"]:
    """The task does not end by itself."""
    return np.zeros(len(states), dtype=bool)


# --- poles on a cart: states are (x, theta, xdot, thetadot) ---------------------------------------------


def balance_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """1 a step."""
    return np.ones(len(after))


def swing_up_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """-|theta| - 0.1 u^2, and 1 while upright, from the pose after the step."""
    return -np.abs(wrap(after[:, 1])) - 0.1 * np.sum(control**2, axis=1) + is_up(after, target)


def swing_up_reward_of_2020(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """The same with the bonus on half the circle: 1 wherever theta < 0.1. Source: 2020 `cartpole_env.py`."""
    theta = wrap(after[:, 1])
    return -np.abs(theta) - 0.1 * np.sum(control**2, axis=1) + (theta < UPRIGHT)


def is_up(states: np.ndarray, targets: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Whether the pole stands."""
    return np.abs(wrap(states[:, 1])) < UPRIGHT


def has_fallen(states: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Whether the pole has fallen, or is not finite."""
    return ~((np.abs(states[:, 1]) <= FALLEN) & np.isfinite(states).all(axis=1))


# --- the reacher: states are two angles and their velocities, targets points ----------------------------


def fingertip(states: Float[np.ndarray, "env 4"]) -> Float[np.ndarray, "env 2"]:
    """Where the reacher's fingertip is [m]."""
    a, b = states[:, 0], states[:, 0] + states[:, 1]
    x = LINK * np.cos(a) + TIP * np.cos(b)
    return np.stack([x, LINK * np.sin(a) + TIP * np.sin(b)], axis=1)


def reach_reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """Minus the fingertip's distance - 0.1 |u|^2, from the pose before the step as in Gymnasium's Reacher."""
    return -_to_target(before, target) - 0.1 * np.sum(control**2, axis=1)


def has_reached(states: np.ndarray, targets: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Whether the fingertip is at the target."""
    return _to_target(states, targets) < REACHED


def _to_target(states: np.ndarray, targets: np.ndarray) -> np.ndarray:
    return np.linalg.norm(fingertip(states) - targets, axis=1)


# --- any robot ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pose:
    """A pose to come to and to hold."""

    model: str
    """MJCF file among the assets."""
    joints: tuple[str, ...]
    """The joints that make the state."""
    goal: tuple[float, ...]
    """The state to come to, of which the positions count."""
    weights: tuple[float, ...]
    """What each degree of freedom's distance from it costs, for a metre or a radian."""
    effort: float
    """What a squared unit of control costs."""
    hold: float = 0.0
    """The control that is free: what holds the pose."""
    tolerance: float = 0.1
    """The pose is reached when every degree of freedom is so near [m, rad]."""

    @cached_property
    def space(self) -> StateSpace:
        """The state space of the model's joints."""
        return StateSpace.from_model(load_model((ASSETS / self.model).read_text()), self.joints)

    def off(self, states: np.ndarray) -> Float[np.ndarray, "env dof"]:
        """How far each degree of freedom is from the goal, the short way round; a rotation as a vector."""
        return np.abs(self.space.difference(states, np.array(self.goal))[:, : self.space.num_dofs])

    def at_goal(self, states: np.ndarray, targets: np.ndarray) -> Bool[np.ndarray, " env"]:
        """Whether the pose is reached."""
        return np.asarray((self.off(states) < self.tolerance).all(axis=1))

    def reward(
        self, before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        """Minus the weighted distance after the step, minus the effort, and 1 at the goal."""
        far = np.minimum(np.sum(self.off(after) * self.weights, axis=1), FAR)
        effort = self.effort * np.sum((control - self.hold) ** 2, axis=1)
        return -far - effort + self.at_goal(after, target)
