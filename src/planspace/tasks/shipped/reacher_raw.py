"""Reach a target with a planar arm; the joint angles are observed."""

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
    """Angles, target, velocities, vector from the target to the fingertip."""
    angles, velocities = states[:, :2], states[:, 2:]
    return np.concatenate([angles, target, velocities, fingertip(states) - target], axis=1)


TASK = Task(
    name="reacher-raw",
    env_id="planspace/ReacherRaw-v0",
    model=ASSETS / "reacher.xml",
    joints=JOINTS,
    start_low=tuple(-x for x in START),
    start_high=START,
    horizon=100,
    frame_skip=2,
    observe=observe,
    obs_fields=(*((joint, "rad") for joint in JOINTS), *LAST_FIELDS),
    trig_columns=(0, 1),  # the joints are limited, so the default would have none
    reward=reach_reward,
    at_goal=has_reached,
    draw_targets=draw_targets,
    problem="reacher",
    return_range=(-14.0, -6.0),
    solved_return=-6.0,
    similar_return=1.0,
    paper_order=4,
)
