"""DeepMind Control's reacher: bring the finger of a planar arm to a target; the reward is sparse.

States are two angles and their velocities [rad, rad/s]; a target is a position [m].
"""

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Bool, Float

from planspace.mjcf.source import ModelSource
from planspace.tasks.dm_control.suite import DMC_PREFIX, HORIZON, read_suite, suite_model
from planspace.tasks.task import Task

LINK = 0.12
"""Length of each link, and the finger's distance from the second joint [m]."""
FINGER_RADIUS = 0.01
TARGET_RADII = {"easy": 0.05, "hard": 0.015}
"""Radius of the target in each task [m]."""
TARGET_HEIGHT = 0.01
NEAREST, FARTHEST = 0.05, 0.2
"""Targets lie between these distances from the first joint [m]."""
WRIST = np.deg2rad(160.0)
"""The second joint is limited to plus and minus this [rad]; the first is not limited."""


@dataclass(frozen=True)
class Reach:
    """Rewards for a finger that touches a target of some size."""

    radius: float
    """Radius of the target [m]."""

    def reward(
        self, before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        """Return 1 if the finger touches the target after the step, else 0."""
        return self.at_goal(after, target).astype(float)

    def at_goal(self, states: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " env"]:
        """Return whether the finger touches the target."""
        return np.linalg.norm(to_target(states, target), axis=1) <= self.radius + FINGER_RADIUS


def to_target(states: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "env 2"]:
    """Return the vector from the finger to the target [m]."""
    angles = np.cumsum(states[:, :2], axis=1)
    finger = LINK * np.stack([np.cos(angles).sum(axis=1), np.sin(angles).sum(axis=1)], axis=1)
    return target - finger


def observe(states: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "env 6"]:
    """Observe the angles, the vector from the finger to the target, and the velocities."""
    return np.concatenate([states[:, :2], to_target(states, target), states[:, 2:]], axis=1)


def draw_targets(num: int, rng: np.random.Generator) -> Float[np.ndarray, "env 2"]:
    """Draw targets of uniform direction and distance."""
    angle, radius = rng.uniform(0.0, 2 * np.pi, num), rng.uniform(NEAREST, FARTHEST, num)
    return radius[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)


def model(radius: float) -> ModelSource:
    """Return dm_control's reacher with a target of this radius [m], which is drawn where the task says."""
    root = ElementTree.fromstring(read_suite("reacher"))
    world = root.find("worldbody")
    target = root.find("./worldbody/geom[@name='target']")
    assert world is not None and target is not None
    world.remove(target)
    moved = ElementTree.SubElement(
        world, "body", {"name": "target", "mocap": "true", "pos": f"0 0 {TARGET_HEIGHT}"}
    )
    target.attrib |= {"size": f"{radius}", "pos": "0 0 0"}
    moved.append(target)
    return suite_model(ElementTree.tostring(root, encoding="unicode"))


def make_tasks() -> list[Task]:
    """Make `reacher-easy` and `reacher-hard`."""
    return [make_task(name, radius) for name, radius in TARGET_RADII.items()]


def make_task(name: str, radius: float) -> Task:
    """Make a task.

    Args:
        name: its name in the domain.
        radius: radius of the target [m].
    """
    functions = Reach(radius)
    return Task(
        name=f"{DMC_PREFIX}reacher-{name}",
        model=model(radius),
        joints=("shoulder", "wrist"),
        start_low=(-np.pi, -WRIST, 0.0, 0.0),
        start_high=(np.pi, WRIST, 0.0, 0.0),
        horizon=HORIZON,
        reward=functions.reward,
        at_goal=functions.at_goal,
        observe=observe,
        obs_fields=(
            ("shoulder", "rad"),
            ("wrist", "rad"),
            ("to_target_x", "m"),
            ("to_target_y", "m"),
            ("shouldervel", "rad/s"),
            ("wristvel", "rad/s"),
        ),
        draw_targets=draw_targets,
    )
