"""Tasks whose aim is to reach a pose and hold it, for any robot."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

if TYPE_CHECKING:
    from planspace.physics.space import StateSpace

MAX_DISTANCE_COST = 5.0
"""Upper bound on the cost of the distance to the pose in one step."""


@dataclass(frozen=True)
class Pose:
    """A pose to reach and to hold; its methods are a task's `reward` and `at_goal`."""

    model: Path
    """The MJCF file."""
    joints: tuple[str, ...]
    """The joints that make the state."""
    goal: tuple[float, ...]
    """The state to reach; only its positions count."""
    weights: tuple[float, ...]
    """Cost of each degree of freedom's distance from the goal, for a metre or a radian."""
    effort: float
    """Cost of a squared unit of control."""
    hold: float = 0.0
    """The control that costs nothing, because it holds the pose."""
    tolerance: float = 0.1
    """The pose is reached if every degree of freedom is closer than this [m, rad]."""

    @cached_property
    def space(self) -> "StateSpace":
        """The state space of the model's joints."""
        from planspace.mjcf.compile import load_model
        from planspace.physics.space import StateSpace

        return StateSpace.from_model(load_model(self.model.read_text()), self.joints)

    def distances(self, states: np.ndarray) -> Float[np.ndarray, "env dof"]:
        """Return each degree of freedom's distance from the goal, the short way round for angles."""
        return np.abs(self.space.difference(states, np.array(self.goal))[:, : self.space.num_dofs])

    def at_goal(self, states: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " env"]:
        """Return whether each state is at the pose."""
        return np.asarray((self.distances(states) < self.tolerance).all(axis=1))

    def reward(
        self, before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        """Minus the weighted distance after the step, minus the effort, plus 1 at the goal."""
        cost = np.minimum(np.sum(self.distances(after) * self.weights, axis=1), MAX_DISTANCE_COST)
        effort = self.effort * np.sum((control - self.hold) ** 2, axis=1)
        return -cost - effort + self.at_goal(after, target)
