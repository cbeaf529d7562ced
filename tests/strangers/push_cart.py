"""A stranger's task with its own model: push a cart on a frictionless rail to the middle and stop it there.

A mass of 1 kg and a force of at most 1 N make a double integrator, for which the answers are known. From
rest at x = -1 the fastest way is to accelerate for 1 s and to brake for 1 s. Doing nothing earns -1 a step.
"""

import numpy as np

import planspace as ps

MODEL = """
<mujoco>
  <option timestep="0.02" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="rail" type="slide" axis="1 0 0" limited="true" range="-2 2"/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor joint="rail" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
PROBLEM = """
model: push_cart.xml
joints: [rail]
start: [-1.0, 0.0]
goal: [0.0, 0.0]
tolerance: 0.05
velocity_bound: 3.0
"""
FASTEST_S = 2.0
"""2 sqrt(distance / acceleration)."""


def reward(before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray) -> np.ndarray:
    return -np.abs(after[:, 0])


def at_goal(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.abs(states).sum(axis=1) < 0.05


TASK = ps.Task(
    name="push-cart",
    model=MODEL,
    joints=("rail",),
    start_low=(-1.0, 0.0),
    start_high=(-1.0, 0.0),
    horizon=40,
    frame_skip=5,
    reward=reward,
    at_goal=at_goal,
)
