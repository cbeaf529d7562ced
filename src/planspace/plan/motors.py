"""Motors that act on one joint: which these are, and how much of their range a plan can use."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.mjcf.compile import stepping
from planspace.physics.space import StateSpace

MAX_ACCELERATION = 1000.0
"""Largest acceleration for which a plan uses a motor [rad/s^2 or m/s^2]; a joint then reaches 50 rad/s, the
default bound, in 0.05 s."""
NUM_POSES = 128
"""Random poses at which inertias and static forces are computed."""


class Motor(NamedTuple):
    """A motor on one hinge or slide."""

    position: int
    """Index of its joint in qpos."""
    dof: int
    """Index of its joint in qvel."""
    gain: float
    """Force or torque on the joint for a control of 1."""


def motor(model: mujoco.MjModel, actuator: int) -> Motor | None:
    """Return the motor that an actuator is; None if it is anything else."""
    joint = int(model.actuator_trnid[actuator, 0])
    gain = float(model.actuator_gear[actuator, 0] * model.actuator_gainprm[actuator, 0])
    is_motor = (
        model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_JOINT)
        and model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_NONE)
        and model.actuator_dyntype[actuator] == int(mujoco.mjtDyn.mjDYN_NONE)
        and model.actuator_gaintype[actuator] == int(mujoco.mjtGain.mjGAIN_FIXED)
    )
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    if not is_motor or gain == 0 or int(model.jnt_type[joint]) not in kinds:
        return None
    return Motor(int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint]), gain)


def limit_accelerations(model: mujoco.MjModel, space: StateSpace) -> None:
    """Narrow the control ranges of motors that are far too strong for their joints.

    Models of arms often give a wrist the torque of an elbow. Random torques in such a range throw the wrist
    beyond any velocity bound within one physics step, and a planner finds no valid edge. The remaining range
    accelerates the joint by at least `MAX_ACCELERATION` and carries its weight, in each of many poses.

    Args:
        model: changed in place.
        space: its state space.
    """
    motors = [(i, found) for i in range(model.nu) if (found := motor(model, i))]
    if space.kinematic or not motors:
        return
    inertias, forces = _largest(model, space)
    for actuator, (_, dof, gain) in motors:
        useful = (MAX_ACCELERATION * inertias[dof] + forces[dof] + model.dof_frictionloss[dof]) / abs(gain)
        low, high = model.actuator_ctrlrange[actuator]
        model.actuator_ctrlrange[actuator] = max(low, -useful), min(high, useful)


def _largest(
    model: mujoco.MjModel, space: StateSpace
) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
    """The largest inertia and the largest static force of each joint over random poses."""
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    inertias, forces, full = np.zeros(model.nv), np.zeros(model.nv), np.zeros((model.nv, model.nv))
    poses = space.sample(rng, NUM_POSES, np.zeros(space.num_dofs))
    for pose in poses:
        space.write_data(pose, data)
        with stepping():
            mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        inertias = np.maximum(inertias, np.diag(full))
        forces = np.maximum(forces, np.abs(data.qfrc_bias - data.qfrc_passive))
    return inertias, forces
