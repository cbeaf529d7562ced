"""A task as a user writes it: an MJCF model and a few functions in one file."""

import numpy as np

import planspace as ps

MODEL = """
<mujoco>
  <option timestep="0.01" integrator="RK4"/>
  <worldbody>
    <body name="mass">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.5" range="-5 5" limited="true"/>
      <geom type="sphere" size="0.1" mass="1" contype="0" conaffinity="0"/>
      <body name="spinner">
        <joint name="spin" type="hinge" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.2" contype="0" conaffinity="0"/>
      </body>
    </body>
    <body name="target" mocap="true" pos="0 0 0"/>
  </worldbody>
  <actuator>
    <motor joint="slide" gear="40" ctrlrange="-1 1" ctrllimited="true"/>
    <motor joint="spin" gear="0.1" ctrlrange="-1 1" ctrllimited="true"/>
  </actuator>
</mujoco>
"""
REACHED = 0.1


def off(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.abs(states[:, 0] - target[:, 0])


def reward(before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray) -> np.ndarray:
    return -off(after, target) - 0.01 * np.sum(control**2, axis=1)


def at_goal(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    return off(states, target) < REACHED


def terminated(states: np.ndarray) -> np.ndarray:
    return np.abs(states[:, 0]) > 1.05


def draw_targets(num: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (num, 1))


TASK = ps.Task(
    name="slide-and-spin",
    model=MODEL,
    joints=("slide", "spin"),
    start_low=(-1, -3, -1, 0),
    start_high=(1, 3, 1, 0),
    horizon=25,
    frame_skip=2,
    reward=reward,
    at_goal=at_goal,
    terminated=terminated,
    draw_targets=draw_targets,
)
