"""Swing two links up with a motor at the elbow.

States are two angles and their velocities [rad, rad/s]; both links are up at 0.
"""

from planspace.mjcf.assets import ASSETS
from planspace.tasks.pose import Pose
from planspace.tasks.task import Task

POSE = Pose(
    model=ASSETS / "acrobot.xml",
    joints=("shoulder", "elbow"),
    goal=(0.0,) * 4,
    weights=(0.5,) * 2,
    effort=0.001,
)

TASK = Task(
    name="acrobot-swingup",
    env_id="planspace/AcrobotSwingUp-v0",
    model=POSE.model,
    joints=POSE.joints,
    start_low=(2.64, -0.5, -0.1, -0.1),
    start_high=(3.64, 0.5, 0.1, 0.1),
    horizon=300,
    frame_skip=2,
    reward=POSE.reward,
    at_goal=POSE.at_goal,
    problem="acrobot",
)
