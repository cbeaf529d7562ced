"""Move an arm with seven joints from one side of a post to the other.

States are angles [rad] and their velocities [rad/s].
"""

from planspace.mjcf.assets import ASSETS
from planspace.tasks.pose import Pose
from planspace.tasks.task import Task

POSE = Pose(
    model=ASSETS / "arm.xml",
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    goal=(1.0, 0.8, 0.0, 1.1, 0.0, 0.3, 0.0, *(0.0,) * 7),
    weights=(0.2,) * 7,
    effort=1e-4,
)

TASK = Task(
    name="arm",
    env_id="planspace/Arm-v0",
    model=POSE.model,
    joints=POSE.joints,
    start_low=(-1.4, 0.6, -0.3, 0.9, -0.5, -0.5, -0.5, *(0.0,) * 7),
    start_high=(-0.8, 1.0, 0.3, 1.3, 0.5, 0.5, 0.5, *(0.0,) * 7),
    horizon=150,
    frame_skip=2,
    trig_columns=tuple(range(7)),  # the joints are limited, so the default would have none
    reward=POSE.reward,
    at_goal=POSE.at_goal,
    problem="arm",
)
