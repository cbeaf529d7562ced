"""Fly a quadrotor to a hover.

States are position [m], quaternion, linear velocity [m/s] and angular velocity [rad/s].
"""

from planspace.mjcf.assets import ASSETS
from planspace.tasks.pose import Pose
from planspace.tasks.task import Task

POSE = Pose(
    model=ASSETS / "quadrotor.xml",
    joints=("body",),
    goal=(0.0, 0.0, 0.0, 1.0, *(0.0,) * 9),
    weights=(1.0, 1.0, 1.0, 0.2, 0.2, 0.2),
    effort=0.02,
    hold=1.22625,
)

TASK = Task(
    name="quadrotor",
    env_id="planspace/Quadrotor-v0",
    model=POSE.model,
    joints=POSE.joints,
    start_low=(*(-1.5,) * 3, 0.8, *(-0.3,) * 3, *(-0.5,) * 6),
    start_high=(*(1.5,) * 3, 1.0, *(0.3,) * 3, *(0.5,) * 6),
    horizon=150,
    frame_skip=2,
    reward=POSE.reward,
    at_goal=POSE.at_goal,
    problem="quadrotor",
)
