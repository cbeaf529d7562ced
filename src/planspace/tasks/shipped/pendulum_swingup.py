"""Swing up a pendulum whose motor is too weak to lift it.

States are (theta, thetadot) [rad, rad/s]; the pendulum is up at theta = 0.
"""

from planspace.mjcf.assets import ASSETS
from planspace.tasks.pose import Pose
from planspace.tasks.task import Task

POSE = Pose(
    model=ASSETS / "pendulum.xml",
    joints=("hinge",),
    goal=(0.0,) * 2,
    weights=(1.0,),
    effort=0.1,
)

TASK = Task(
    name="pendulum-swingup",
    env_id="planspace/PendulumSwingUp-v0",
    model=POSE.model,
    joints=POSE.joints,
    start_low=(-3.14, -0.1),
    start_high=(3.14, 0.1),
    horizon=200,
    frame_skip=2,
    reward=POSE.reward,
    at_goal=POSE.at_goal,
    problem="pendulum",
)
