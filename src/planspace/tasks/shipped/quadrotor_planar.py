"""Fly a quadrotor in a vertical plane to a hover.

States are (x, z, pitch) and their velocities [m, m, rad, m/s, m/s, rad/s].
"""

from planspace.mjcf.assets import ASSETS
from planspace.tasks.pose import Pose
from planspace.tasks.task import Task

POSE = Pose(
    model=ASSETS / "quadrotor-planar.xml",
    joints=("x", "z", "pitch"),
    goal=(0.0,) * 6,
    weights=(1.0, 1.0, 0.2),
    effort=0.01,
    hold=2.4525,
)

TASK = Task(
    name="quadrotor-planar",
    env_id="planspace/QuadrotorPlanar-v0",
    model=POSE.model,
    joints=POSE.joints,
    start_low=(-1.5, -1.5, -1.0, -0.5, -0.5, -0.5),
    start_high=(1.5, 1.5, 1.0, 0.5, 0.5, 0.5),
    horizon=150,
    frame_skip=2,
    reward=POSE.reward,
    at_goal=POSE.at_goal,
    problem="quadrotor-planar",
)
