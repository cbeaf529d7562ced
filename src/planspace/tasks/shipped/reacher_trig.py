"""Reach a target with a planar arm; the cosines and sines of the joint angles are observed."""

import numpy as np

from planspace.mjcf.assets import ASSETS
from planspace.tasks.reacher import (
    JOINTS,
    LAST_FIELDS,
    START,
    draw_targets,
    fingertip,
    has_reached,
    reach_reward,
)
from planspace.tasks.task import Task


def observe(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Cosines and sines of the angles, target, velocities, vector from the target to the fingertip."""
    angles, velocities = states[:, :2], states[:, 2:]
    parts = [np.cos(angles), np.sin(angles), target, velocities, fingertip(states) - target]
    return np.concatenate(parts, axis=1)


TASK = Task(
    name="reacher-trig",
    env_id="planspace/ReacherTrig-v0",
    model=ASSETS / "reacher.xml",
    joints=JOINTS,
    start_low=tuple(-x for x in START),
    start_high=START,
    horizon=100,
    frame_skip=2,
    observe=observe,
    obs_fields=(
        *((f"{function}_{joint}", "") for function in ("cos", "sin") for joint in JOINTS),
        *LAST_FIELDS,
    ),
    trig_columns=(),  # the observation already has them
    reward=reach_reward,
    at_goal=has_reached,
    draw_targets=draw_targets,
    problem="reacher",
    return_range=(-14.0, -6.0),
    solved_return=-6.0,
    similar_return=1.0,
    paper_order=3,
)
