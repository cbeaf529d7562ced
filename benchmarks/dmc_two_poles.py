"""DeepMind Control's swing-up of a cart-pole with two poles as a task of planspace (extra `robots`).

    planspace train benchmarks/dmc_two_poles.py:TASK --out policies
    planspace control benchmarks/dmc_two_poles.py:TASK --embedding DIR --out episodes

`planspace.plan_demos(PROBLEM)` plans demonstrations. tests/tasks/test_dm_control.py compares the task with
dm_control's.
"""

import numpy as np
from dm_control.suite import cartpole
from dm_control.utils import rewards

from planspace.mjcf.source import ModelSource
from planspace.tasks.problem import Box, Problem
from planspace.tasks.task import Task

HANGING = np.array([0.0, np.pi, 0.0, 0.0, 0.0, 0.0])
SPREAD = np.array([0.01, 0.01, 0.1, 0.01, 0.01, 0.01])
"""Standard deviation of the first states around `HANGING` [m, rad, m/s, rad/s]."""


def dmc_model() -> ModelSource:
    text, assets = cartpole.get_model_and_assets(num_poles=2)
    text = text.decode() if isinstance(text, bytes) else text
    return ModelSource(text, files=tuple((name.removeprefix("./"), data) for name, data in assets.items()))


def pole_angles(states: np.ndarray) -> np.ndarray:
    """The angle of each pole from the vertical [env, pole]."""
    return np.cumsum(states[:, 1:3], axis=1)


def reward(before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray) -> np.ndarray:
    upright = ((np.cos(pole_angles(after)) + 1) / 2).mean(axis=1)
    centered = (1 + rewards.tolerance(after[:, 0], margin=2)) / 2
    effort = rewards.tolerance(control[:, 0], margin=1, value_at_margin=0, sigmoid="quadratic")
    slow = rewards.tolerance(after[:, 4:], margin=5).min(axis=1)
    return upright * (4 + effort) / 5 * (1 + slow) / 2 * centered


def at_goal(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Whether the sparse reward of dm_control is 1."""
    return (np.abs(states[:, 0]) <= 0.25) & (np.cos(pole_angles(states)) >= 0.995).all(axis=1)


def observe(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    angles = pole_angles(states)
    poles = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(states), -1)
    return np.concatenate([states[:, :1], poles, states[:, 3:]], axis=1)


def draw_starts(num: int, rng: np.random.Generator) -> np.ndarray:
    return HANGING + SPREAD * rng.standard_normal((num, len(HANGING)))


PROBLEM = Problem(
    name="dmc-two-poles",
    model=dmc_model(),
    joints=("slider", "hinge_1", "hinge_2"),
    start=Box(tuple(HANGING - 3 * SPREAD), tuple(HANGING + 3 * SPREAD)),
    goal=Box((0.0,) * 6, (0.0,) * 6),
    tolerance=0.1,
    sample_velocity=(4.0, 10.0, 12.0),
)

TASK = Task(
    name="dmc-two-poles",
    model=PROBLEM.source,
    joints=PROBLEM.joints,
    start_low=PROBLEM.start.low,
    start_high=PROBLEM.start.high,
    horizon=1000,
    reward=reward,
    at_goal=at_goal,
    observe=observe,
    obs_fields=(
        ("slider", "m"),
        *((f"{part}_{pole}", "") for pole in (1, 2) for part in ("cos", "sin")),
        ("slidervel", "m/s"),
        ("hinge_1vel", "rad/s"),
        ("hinge_2vel", "rad/s"),
    ),
    trig_columns=(),
    draw_starts=draw_starts,
    problem=PROBLEM,
)
