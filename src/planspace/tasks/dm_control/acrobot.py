"""DeepMind Control's acrobot: swing two links up with a motor at the elbow that is too weak to lift them.

States are two angles and their velocities [rad, rad/s]; both links are up at 0.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from planspace.tasks.dm_control.suite import DMC_PREFIX, HORIZON, read_suite, suite_model
from planspace.tasks.dm_control.tolerance import within
from planspace.tasks.problem import Box, Problem
from planspace.tasks.task import Task

TARGET = (0.0, 4.0)
"""Where the tip should be [m]: x and z."""
SHOULDER = (0.0, 2.0)
RADIUS = 0.2
"""Radius of the target [m]."""


@dataclass(frozen=True)
class TipUp:
    """The reward for a tip near its target."""

    margin: float
    """Distance from the target at which the reward is 0.1 [m]; 0 for a reward of 1 at the target only."""

    def reward(
        self, before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        """Return the reward of the tip's position after the step."""
        return within(to_target(after), 0.0, RADIUS, self.margin)


def directions(states: np.ndarray) -> tuple[Float[np.ndarray, "env 2"], Float[np.ndarray, "env 2"]]:
    """Return the x and z of each link's direction."""
    angles = np.cumsum(states[:, :2], axis=1)
    return np.sin(angles), np.cos(angles)


def to_target(states: np.ndarray) -> Float[np.ndarray, " env"]:
    """Return the distance of the tip from its target [m]."""
    tip = np.stack([part.sum(axis=1) for part in directions(states)], axis=1) + SHOULDER
    return np.linalg.norm(np.array(TARGET) - tip, axis=1)


def at_goal(states: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Return whether the tip is at its target."""
    return to_target(states) <= RADIUS


def observe(states: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "env 6"]:
    """Observe the directions of the links, and the velocities."""
    return np.concatenate([*directions(states), states[:, 2:]], axis=1)


def make_tasks() -> list[Task]:
    """Make `acrobot-swingup` and `acrobot-swingup-sparse`."""
    problem = Problem(
        name="dmc-acrobot",
        model=suite_model(read_suite("acrobot")),
        joints=("shoulder", "elbow"),
        start=Box((-np.pi, -np.pi, 0.0, 0.0), (np.pi, np.pi, 0.0, 0.0)),
        goal=Box((0.0,) * 4, (0.0,) * 4),
        tolerance=0.1,
        sample_velocity=(8.0, 12.0),
    )
    dense = Task(
        name=f"{DMC_PREFIX}acrobot-swingup",
        model=problem.source,
        joints=problem.joints,
        start_low=problem.start.low,
        start_high=problem.start.high,
        horizon=HORIZON,
        reward=TipUp(margin=1.0).reward,
        at_goal=at_goal,
        observe=observe,
        obs_fields=(
            *((f"{part}_{link}", "") for part in ("x", "z") for link in ("upper", "lower")),
            ("shouldervel", "rad/s"),
            ("elbowvel", "rad/s"),
        ),
        trig_columns=(),
        problem=problem,
    )
    return [dense, replace(dense, name=f"{dense.name}-sparse", reward=TipUp(margin=0.0).reward)]
