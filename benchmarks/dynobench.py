"""The acrobot, the planar quadrotor and the planar quadrotor with a pole of dynobench, written as MJCF.

Source: https://github.com/quimortiz/dynobench (Ortiz-Haro, Hönig, Hartmann and Toussaint 2023), MIT licence.
Its files `SYSTEM.model.yaml` and `SYSTEM.PROBLEM.yaml` are read from a folder; none is in this repository.

    acrobot_v0     q = (q1, q2)            u = torque of the second joint [N m]
    quad2d_v0      q = (x, y, theta)       u = thrusts of the right and the left rotor, relative to m g / 2
    quad2dpole_v0  q = (x, y, theta, q)    as before; q is the angle of the pole relative to the quadrotor

As in dynobench the plane is x-y, y points up, angles count anticlockwise from hanging rods and level rotors,
nothing is damped, and obstacles are boxes. Rods and quadrotors collide as boxes; contacts are forbidden.
Positions have the bounds of the workspace, velocities and theta those of the model.

The tolerance is dynobench's: 0.03 in its weighted distance. Here it is a sum of absolute differences where
dynobench takes Euclidean norms of positions and of velocities, so our goal regions lie within dynobench's.
Plans need not hold the goal, as there. dynobench integrates with explicit Euler steps of 0.01 s; here the
steps are Runge-Kutta of the same length, with the control constant in each.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from planspace.tasks.problem import Box, Problem

GRAVITY = 9.81
TIMESTEP = 0.01
TOLERANCE = 0.03
"""`Feasibility_thresholds::goal_tol` of dynobench."""
ROD_WIDTH = 0.1
"""Width of the boxes with which rods collide [m]."""
POLE_QUADROTOR = (0.5, 0.25)
"""Size of the quadrotor with a pole [m]; the default of dynobench, because its file has none."""
POINT_INERTIA = 1e-13
"""Inertia of the point mass at the end of the pole [kg m^2]; MuJoCo needs a positive number."""
DEPTH = 0.5
"""Half the depth of obstacles [m]; robots are a tenth as deep."""


@dataclass(frozen=True)
class System:
    """One robot: its part of the model, and what bounds its states."""

    bodies: str
    """MJCF of the body with its joints."""
    actuators: str
    """MJCF of the actuators."""
    joints: tuple[str, ...]
    """The joints, in the order of dynobench's states."""
    weights: tuple[float, ...]
    """Weight of each number of a state in the distance to the goal."""
    velocity_bound: tuple[float, ...]
    """Bounds of the velocities [m/s or rad/s]."""


def problem_names(folder: Path) -> list[str]:
    """The problems of the three systems in a folder, as SYSTEM.PROBLEM."""
    files = sorted(path.name.removesuffix(".yaml") for path in folder.glob("*_v0.*.yaml"))
    return [name for name in files if name.partition(".")[0] in SYSTEMS and not name.endswith(".model")]


def load_dynobench(folder: Path, name: str) -> Problem:
    """Read one problem, given as SYSTEM.PROBLEM, with its system."""
    kind = name.partition(".")[0]
    system = SYSTEMS[kind](yaml.safe_load((folder / f"{kind}.model.yaml").read_text()))
    content = yaml.safe_load((folder / f"{name}.yaml").read_text())
    place, (robot,) = content["environment"], content["robots"]
    start, goal = (tuple(map(float, robot[key])) for key in ("start", "goal"))
    bounds = zip(("x", "y"), place["min"], place["max"], strict=True)
    return Problem(
        name=name,
        model=mjcf(kind, system, place["obstacles"]),
        joints=system.joints,
        start=Box(start, start),
        goal=Box(goal, goal),
        tolerance=TOLERANCE,
        goal_weights=system.weights,
        velocity_bound=system.velocity_bound,
        position_bounds=tuple(
            (joint, (float(low),), (float(high),)) for joint, low, high in bounds if joint in system.joints
        ),
        forbidden_contacts="all" if place["obstacles"] else "none",
        hold=False,
    )


def mjcf(name: str, system: System, obstacles: list[dict[str, Any]]) -> str:
    """The model of a system among obstacles."""
    boxes = "".join(
        f"""
    <geom name="obstacle{number}" type="box" pos="{_numbers(*box["center"], 0)}"
          size="{_numbers(*(side / 2 for side in box["size"]), DEPTH)}" rgba="0.6 0.6 0.6 1"/>"""
        for number, box in enumerate(obstacles)
    )
    return f"""<mujoco model="{name}">
  <compiler angle="radian" inertiafromgeom="false"/>
  <option timestep="{TIMESTEP}" integrator="RK4" gravity="0 {-GRAVITY} 0">
    <flag autoreset="disable"/>
  </option>
  <worldbody>
    <camera name="front" pos="0 0 8"/>{boxes}{system.bodies}
  </worldbody>
  <actuator>{system.actuators}
  </actuator>
</mujoco>
"""


def acrobot(model: dict[str, Any]) -> System:
    """Two rods with a motor at the second joint. Both inertias of dynobench are about the rods' pivots."""
    l1, l2, lc1, lc2, m1, m2, i1, i2 = (
        float(model[key]) for key in ("l1", "l2", "lc1", "lc2", "m1", "m2", "I1", "I2")
    )
    torque, speed = float(model["max_torque"]), float(model["max_angular_vel"])
    bodies = f"""
    <body name="upper">
      <joint name="q1" type="hinge" axis="0 0 1" limited="false"/>
      {_inertial(-lc1, m1, i1 - m1 * lc1**2)}
      {_rod("upper", -lc1, l1)}
      <body name="lower" pos="{_numbers(0, -l1, 0)}">
        <joint name="q2" type="hinge" axis="0 0 1" limited="false"/>
        {_inertial(-lc2, m2, i2 - m2 * lc2**2)}
        {_rod("lower", -lc2, l2)}
      </body>
    </body>"""
    actuators = f"""
    <motor name="torque" joint="q2" ctrllimited="true" ctrlrange="{_numbers(-torque, torque)}"/>"""
    q1, q2, v = map(float, model["distance_weights"])
    return System(bodies, actuators, ("q1", "q2"), (q1, q2, v, v), (speed, speed))


def quadrotor(model: dict[str, Any]) -> System:
    """A quadrotor in a vertical plane."""
    width, height = model["size"]
    bodies = f"""
    <body name="quadrotor">{_flight(model, limit="")}{_frame(model, width, height)}
    </body>"""
    speed, turn = float(model["max_vel"]), float(model["max_angular_vel"])
    p, r, v, w = map(float, model["distance_weights"])
    return System(bodies, _rotors(model), ("x", "y", "theta"), (p, p, r, v, v, w), (speed, speed, turn))


def quadrotor_with_pole(model: dict[str, Any]) -> System:
    """A quadrotor in a vertical plane; a point mass on a massless rod turns about its centre."""
    mass, length = float(model["m_p"]), float(model["r"])
    limit = f'range="{_numbers(-model["yaw_max"], model["yaw_max"])}"'
    bodies = f"""
    <body name="quadrotor">{_flight(model, limit=limit)}{_frame(model, *POLE_QUADROTOR)}
      <body name="pole">
        <joint name="q" type="hinge" axis="0 0 1" limited="false"/>
        {_inertial(-length, mass, POINT_INERTIA)}
        {_rod("pole", -length / 2, length)}
      </body>
    </body>"""
    speed, turn = float(model["max_vel"]), float(model["max_angular_vel"])
    p, r, q, v, w, vq = map(float, model["distance_weights"])
    weights = (p, p, r, q, v, v, w, vq)
    return System(bodies, _rotors(model), ("x", "y", "theta", "q"), weights, (speed, speed, turn, turn))


SYSTEMS = {"acrobot_v0": acrobot, "quad2d_v0": quadrotor, "quad2dpole_v0": quadrotor_with_pole}


def _flight(model: dict[str, Any], limit: str) -> str:
    """The joints of a quadrotor and its mass; `limit` is the range of theta."""
    return f"""
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="theta" type="hinge" axis="0 0 1" {limit or 'limited="false"'}/>
      {_inertial(0.0, float(model["m"]), float(model["I"]))}"""


def _frame(model: dict[str, Any], width: float, height: float) -> str:
    arm = float(model["l"])
    return f"""
      <geom name="frame" type="box" size="{_numbers(width / 2, height / 2, DEPTH / 10)}"/>
      <site name="right" pos="{_numbers(arm, 0, 0)}"/>
      <site name="left" pos="{_numbers(-arm, 0, 0)}"/>"""


def _rotors(model: dict[str, Any]) -> str:
    """Two thrusts along the quadrotor's y axis; a control of 1 lifts half of its mass, without the pole's."""
    gear = _numbers(0, 0.5 * float(model["m"]) * GRAVITY, 0, 0, 0, 0)
    return "".join(
        f"""
    <motor name="{site}" site="{site}" gear="{gear}" ctrllimited="true"
           ctrlrange="{_numbers(0, model["max_f"])}"/>"""
        for site in ("right", "left")
    )


def _inertial(y: float, mass: float, inertia: float) -> str:
    return f'<inertial pos="{_numbers(0, y, 0)}" mass="{mass!r}" diaginertia="{_numbers(*[inertia] * 3)}"/>'


def _rod(name: str, y: float, length: float) -> str:
    size = _numbers(ROD_WIDTH / 2, length / 2, DEPTH / 10)
    return f'<geom name="{name}" type="box" pos="{_numbers(0, y, 0)}" size="{size}"/>'


def _numbers(*values: float) -> str:
    """Numbers for MJCF, with all digits."""
    return " ".join(repr(float(np.float64(value))) for value in values)
