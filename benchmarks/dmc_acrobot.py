"""DeepMind Control's acrobot swing-up as a task of planspace (extra `robots`).

    planspace train benchmarks/dmc_acrobot.py:TASK --out policies
    planspace control benchmarks/dmc_acrobot.py:TASK --embedding DIR --out episodes

`planspace.plan_demos(PROBLEM)` plans demonstrations. tests/tasks/test_dm_control.py compares the task with
dm_control's.
"""

import numpy as np
from dm_control.suite import acrobot
from dm_control.utils import rewards

from planspace.mjcf.source import ModelSource
from planspace.tasks.problem import Box, Problem
from planspace.tasks.task import Task

TARGET = np.array([0.0, 4.0])
"""Where the tip should be [m]: x and z."""
SHOULDER = np.array([0.0, 2.0])
RADIUS = 0.2
"""Radius of the target [m]."""


def dmc_model() -> ModelSource:
    text, assets = acrobot.get_model_and_assets()
    text = text.decode() if isinstance(text, bytes) else text
    return ModelSource(text, files=tuple((name.removeprefix("./"), data) for name, data in assets.items()))


def directions(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The x and z of each rod's direction [env, rod]."""
    angles = np.cumsum(states[:, :2], axis=1)
    return np.sin(angles), np.cos(angles)


def to_target(states: np.ndarray) -> np.ndarray:
    """Distance of the tip from the target [m]."""
    tip = SHOULDER + np.stack([part.sum(axis=1) for part in directions(states)], axis=1)
    return np.linalg.norm(TARGET - tip, axis=1)


def reward(before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.asarray(rewards.tolerance(to_target(after), bounds=(0, RADIUS), margin=1))


def at_goal(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    return to_target(states) <= RADIUS


def observe(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.concatenate([*directions(states), states[:, 2:]], axis=1)


PROBLEM = Problem(
    name="dmc-acrobot",
    model=dmc_model(),
    joints=("shoulder", "elbow"),
    start=Box((-np.pi, -np.pi, 0.0, 0.0), (np.pi, np.pi, 0.0, 0.0)),
    goal=Box((0.0,) * 4, (0.0,) * 4),
    tolerance=0.1,
    sample_velocity=(8.0, 12.0),
)

TASK = Task(
    name="dmc-acrobot-swingup",
    model=PROBLEM.source,
    joints=PROBLEM.joints,
    start_low=PROBLEM.start.low,
    start_high=PROBLEM.start.high,
    horizon=1000,
    reward=reward,
    at_goal=at_goal,
    observe=observe,
    obs_fields=(
        *((f"{part}_{rod}", "") for part in ("x", "z") for rod in ("upper", "lower")),
        ("shouldervel", "rad/s"),
        ("elbowvel", "rad/s"),
    ),
    trig_columns=(),
    problem=PROBLEM,
)
