"""Holding joints at a position: they are taken out of the model, together with what only they move.

A held joint's body is put where the joint would hold it, so the rest of the robot moves as if the joint were
blocked.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from planspace.errors import PlanspaceError

HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
BALL, FREE = mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_FREE
Positions = Mapping[str, Sequence[float]]
"""Joint to its position: one number, a quaternion, or a position and a quaternion."""


def hold_joints(spec: mujoco.MjSpec, held: Positions, reference: Positions) -> None:
    """Take joints out of a model, with the actuators, tendons, equalities and sensors that only they have.

    Keyframes are removed, too, because they would no longer fit.

    Args:
        spec: the model; it is changed.
        held: joint to the position at which it is held.
        reference: every joint to its position in the reference pose; see `reference_positions`.

    Raises:
        PlanspaceError: a joint that is not held is coupled to a held one.
    """
    for key in list(spec.keys):
        spec.delete(key)
    gone = {(mujoco.mjtObj.mjOBJ_JOINT, name) for name in held}
    gone |= _remove_tendons(spec, held)
    names = {name for _, name in gone}
    _remove_equalities(spec, held, {name for kind, name in gone if kind == mujoco.mjtObj.mjOBJ_TENDON})
    for actuator in [a for a in spec.actuators if _moves(a) and a.target in names]:
        gone.add((mujoco.mjtObj.mjOBJ_ACTUATOR, actuator.name))
        spec.delete(actuator)
    for sensor in [s for s in spec.sensors if (s.objtype, s.objname) in gone]:
        spec.delete(sensor)
    for body in spec.bodies:
        for joint in [joint for joint in body.joints if joint.name in held]:
            _move_body(spec, body, joint, np.array(held[joint.name], dtype=float), reference[joint.name])
            spec.delete(joint)


def _moves(actuator: Any) -> bool:
    kinds = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT, mujoco.mjtTrn.mjTRN_TENDON)
    return actuator.trntype in kinds


def _remove_tendons(spec: mujoco.MjSpec, held: Positions) -> set[tuple[Any, str]]:
    """Remove the fixed tendons of held joints, and return their names."""
    removed = set()
    for tendon in list(spec.tendons):
        joints = {wrap.target.name for wrap in tendon.path if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT}
        if joints & held.keys():
            _check_coupling(f"the tendon {tendon.name!r}" if tendon.name else "a tendon", joints, held)
            removed.add((mujoco.mjtObj.mjOBJ_TENDON, tendon.name))
            spec.delete(tendon)
    return removed


def _remove_equalities(spec: mujoco.MjSpec, held: Positions, tendons: set[str]) -> None:
    """Remove the equalities of held joints and of removed tendons."""
    for equality in list(spec.equalities):
        ends = {name for name in (equality.name1, equality.name2) if name}
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and ends & held.keys():
            _check_coupling(f"the equality {equality.name!r}" if equality.name else "an equality", ends, held)
            spec.delete(equality)
        elif equality.type == mujoco.mjtEq.mjEQ_TENDON and ends & tendons:
            spec.delete(equality)


def _check_coupling(what: str, joints: set[str], held: Positions) -> None:
    if moving := sorted(joints - held.keys()):
        raise PlanspaceError(
            f"{what} couples {min(joints & held.keys())!r}, which is held, to {moving[0]!r}, which moves. "
            "Put both in joints, or hold both."
        )


def reference_positions(model: mujoco.MjModel) -> dict[str, tuple[float, ...]]:
    """Return the position of every joint in the reference pose, at which bodies are where the model says."""
    return joint_positions(model, model.qpos0)


def joint_positions(model: mujoco.MjModel, qpos: np.ndarray) -> dict[str, tuple[float, ...]]:
    """Return the position of every joint in qpos."""
    return _by_joint(model, qpos, model.jnt_qposadr)


def joint_velocities(model: mujoco.MjModel, qvel: np.ndarray) -> dict[str, tuple[float, ...]]:
    """Return the velocity of every joint in qvel."""
    return _by_joint(model, qvel, model.jnt_dofadr)


def activated(model: mujoco.MjModel) -> np.ndarray:
    """Return the number of the actuator that each activation belongs to."""
    return np.repeat(np.arange(model.nu), np.maximum(model.actuator_actnum, 0))


def _by_joint(model: mujoco.MjModel, numbers: np.ndarray, firsts: np.ndarray) -> dict[str, tuple[float, ...]]:
    """Each joint's part of an array, given the index where each part begins."""
    parts = np.split(numbers, firsts[1:])
    return {model.joint(i).name: tuple(parts[i].tolist()) for i in range(model.njnt)}


def _move_body(
    spec: mujoco.MjSpec, body: Any, joint: Any, position: np.ndarray, reference: Sequence[float]
) -> None:
    """Put a body where a joint at this position holds it.

    The joint moves the body by a rigid motion in the body's own frame. Joints that come before it on the same
    body act in the frame before that motion, so their axes are expressed in the new frame.
    """
    if position.tolist() == list(reference):
        return
    shift, turn = _motion(joint, position, reference)
    if joint.type == FREE:
        body.pos, body.quat, body.alt.type = shift, turn, mujoco.mjtOrientation.mjORIENTATION_QUAT
        return
    orientation = _orientation(spec, body)
    body.pos = np.array(body.pos) + _rotate(shift, orientation)
    body.quat, body.alt.type = _product(orientation, turn), mujoco.mjtOrientation.mjORIENTATION_QUAT
    back = _conjugate(turn)
    for other in body.joints:
        if other.name == joint.name:
            break
        other.axis = _rotate(np.array(other.axis), back)
        other.pos = _rotate(np.array(other.pos) - shift, back)


def _motion(joint: Any, position: np.ndarray, reference: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """The motion of a body at a joint's position, in the body's frame: a shift and a quaternion."""
    none = np.array([1.0, 0.0, 0.0, 0.0])
    if joint.type == FREE:
        return position[:3], position[3:]
    anchor = np.array(joint.pos, dtype=float)
    if joint.type == BALL:
        return anchor - _rotate(anchor, position), position
    axis = np.array(joint.axis, dtype=float)
    axis /= np.linalg.norm(axis)
    amount = float(position[0]) - reference[0]
    if joint.type == SLIDE:
        return amount * axis, none
    turn = np.concatenate([[np.cos(amount / 2)], np.sin(amount / 2) * axis])
    return anchor - _rotate(anchor, turn), turn


def _orientation(spec: mujoco.MjSpec, body: Any) -> np.ndarray:
    """The quaternion of a body in its frame, however the model writes it."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        quat = np.array(body.quat, dtype=float)
        return quat / np.linalg.norm(quat)
    compiler = body.compiler if hasattr(body, "compiler") else spec.compiler
    return np.array(
        spec.resolve_orientation(degree=compiler.degree, sequence=compiler.eulerseq, orientation=body.alt)
    )


def _rotate(vector: np.ndarray, quat: np.ndarray) -> np.ndarray:
    rotated = np.empty(3)
    mujoco.mju_rotVecQuat(rotated, np.asarray(vector, dtype=float), quat)
    return rotated


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    product = np.empty(4)
    mujoco.mju_mulQuat(product, a, b)
    return product


def _conjugate(quat: np.ndarray) -> np.ndarray:
    return quat * np.array([1.0, -1.0, -1.0, -1.0])
