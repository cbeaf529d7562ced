"""DeepMind Control's pendulum: swing up with a motor too weak to lift it; the reward is sparse.

States are an angle and its velocity [rad, rad/s]; the pendulum is up at 0.
"""

import numpy as np
from jaxtyping import Bool, Float

from planspace.tasks.dm_control.suite import DMC_PREFIX, HORIZON, read_suite, suite_model
from planspace.tasks.problem import Box, Problem
from planspace.tasks.task import Task

MAX_DEGREES = 8.0
"""The pendulum is up if its angle from the vertical is at most this."""


def reward(
    before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
) -> Float[np.ndarray, " env"]:
    """Return 1 if the pendulum is up, else 0."""
    return at_goal(after, target).astype(float)


def at_goal(states: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " env"]:
    """Return whether the pendulum is up."""
    return np.cos(states[:, 0]) >= np.cos(np.deg2rad(MAX_DEGREES))


def observe(states: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "env 3"]:
    """Observe the cosine and sine of the angle, and the velocity."""
    return np.stack([np.cos(states[:, 0]), np.sin(states[:, 0]), states[:, 1]], axis=1)


def make_tasks() -> list[Task]:
    """Make `pendulum-swingup`."""
    problem = Problem(
        name="dmc-pendulum",
        model=suite_model(read_suite("pendulum")),
        joints=("hinge",),
        start=Box((-np.pi, 0.0), (np.pi, 0.0)),
        goal=Box((0.0, 0.0), (0.0, 0.0)),
        tolerance=0.1,
        sample_velocity=(8.0,),
    )
    task = Task(
        name=f"{DMC_PREFIX}pendulum-swingup",
        model=problem.source,
        joints=problem.joints,
        start_low=problem.start.low,
        start_high=problem.start.high,
        horizon=HORIZON,
        reward=reward,
        at_goal=at_goal,
        observe=observe,
        obs_fields=(("cos", ""), ("sin", ""), ("hingevel", "rad/s")),
        trig_columns=(),
        problem=problem,
    )
    return [task]
