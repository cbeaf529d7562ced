"""The kinds of joints in a MuJoCo model: their numbers in a state, units and bounds."""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import mujoco
import numpy as np

from planspace.errors import UsageError, unknown

Kind = Literal["slide", "hinge", "circle", "ball", "free"]
"""`circle` is an unlimited hinge whose number of turns does not matter."""
PositionBounds = Mapping[str, tuple[Sequence[float], Sequence[float]]]
"""Joint name to its lower and upper bounds."""


class Numbers(NamedTuple):
    """The numbers that one joint has in a state."""

    positions: tuple[str, ...]
    """Suffixes of their names."""
    velocities: tuple[str, ...]
    """Suffixes of their names."""
    position_units: tuple[str, ...]
    """A quaternion has none."""
    velocity_units: tuple[str, ...]


_XYZ, _QUATERNION, _ROTATION = ("_x", "_y", "_z"), ("_qw", "_qx", "_qy", "_qz"), ("_rx", "_ry", "_rz")

NUMBERS: dict[Kind, Numbers] = {
    "slide": Numbers(("",), ("",), ("m",), ("m/s",)),
    "hinge": Numbers(("",), ("",), ("rad",), ("rad/s",)),
    "circle": Numbers(("",), ("",), ("rad",), ("rad/s",)),
    "ball": Numbers(_QUATERNION, _ROTATION, ("",) * 4, ("rad/s",) * 3),
    "free": Numbers(
        (*_XYZ, *_QUATERNION),
        (*_XYZ, *_ROTATION),
        ("m",) * 3 + ("",) * 4,
        ("m/s",) * 3 + ("rad/s",) * 3,
    ),
}
_KINDS: dict[int, Kind] = {
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
}
TURN = 2 * np.pi
"""An unlimited hinge that counts its turns is bounded to a turn in each direction, unless the user says
otherwise [rad]."""
_NUM_BOUNDS: dict[Kind, int] = {"slide": 1, "hinge": 1, "free": 3}
"""Positions for which the user may set bounds."""


def find_joint(model: mujoco.MjModel, name: str) -> int:
    """Return the id of a joint.

    Raises:
        UsageError: the model has no joint of that name.
    """
    known = [model.joint(i).name for i in range(model.njnt)]
    if name not in known:
        raise unknown("joint", name, known)
    return known.index(name)


def joint_kind(model: mujoco.MjModel, joint: int) -> Kind:
    """Return the kind of the joint with this id.

    An unlimited hinge is a circle only if nothing in the model depends on its number of turns.
    """
    kind: Kind = _KINDS[int(model.jnt_type[joint])]
    if kind != "hinge" or model.jnt_limited[joint] or counts_turns(model, joint):
        return kind
    return "circle"


def counts_turns(model: mujoco.MjModel, joint: int) -> bool:
    """Whether the dynamics depend on a hinge's number of turns: by a spring, servo, tendon or equality."""
    if model.jnt_stiffness[joint] or _has_servo(model, mujoco.mjtTrn.mjTRN_JOINT, joint):
        return True
    for i in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
        if joint in (model.eq_obj1id[i], model.eq_obj2id[i]):
            return True
    return any(_tendon_counts(model, tendon) for tendon in _tendons_of(model, joint))


def _tendons_of(model: mujoco.MjModel, joint: int) -> list[int]:
    """The fixed tendons that a joint belongs to."""
    found = []
    for tendon in range(model.ntendon):
        first = model.tendon_adr[tendon]
        wraps = slice(first, first + model.tendon_num[tendon])
        is_joint = model.wrap_type[wraps] == int(mujoco.mjtWrap.mjWRAP_JOINT)
        if (is_joint & (model.wrap_objid[wraps] == joint)).any():
            found.append(tendon)
    return found


def _tendon_counts(model: mujoco.MjModel, tendon: int) -> bool:
    equalities = model.eq_type == int(mujoco.mjtEq.mjEQ_TENDON)
    in_equality = equalities & ((model.eq_obj1id == tendon) | (model.eq_obj2id == tendon))
    return bool(
        model.tendon_stiffness[tendon]
        or model.tendon_limited[tendon]
        or in_equality.any()
        or _has_servo(model, mujoco.mjtTrn.mjTRN_TENDON, tendon)
    )


def _has_servo(model: mujoco.MjModel, transmission: mujoco.mjtTrn, target: int) -> bool:
    """Whether an actuator of this joint or tendon has a force that depends on its length."""
    of_target = (model.actuator_trntype == int(transmission)) & (model.actuator_trnid[:, 0] == target)
    by_length = (model.actuator_biasprm[:, 1] != 0) | (model.actuator_gainprm[:, 1] != 0)
    return bool((of_target & by_length).any())


def numbers_of(
    joints: Sequence[str], kinds: Sequence[Kind]
) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Return the name and unit of each position of some joints, and of each velocity."""
    positions, velocities = [], []
    for name, numbers in zip(joints, (NUMBERS[kind] for kind in kinds), strict=True):
        own = [name + part for part in numbers.positions]
        positions += zip(own, numbers.position_units, strict=True)
        own = [f"{name}{part}vel" for part in numbers.velocities]
        velocities += zip(own, numbers.velocity_units, strict=True)
    return positions, velocities


def one_for_each(velocity_bound: float | Sequence[float], num: int) -> np.ndarray:
    """Return a bound for each of `num` velocities from one for all or one for each.

    Raises:
        UsageError: there is another number of bounds.
    """
    bound = np.asarray(velocity_bound, dtype=float)
    if bound.ndim and len(bound) != num:
        raise UsageError(f"velocity_bound has {len(bound)} numbers; the joints have {num} velocities.")
    return np.broadcast_to(bound, (num,)).copy()


def qpos_indices(model: mujoco.MjModel, joint: int) -> list[int]:
    """Indices of a joint's positions in qpos."""
    count = len(NUMBERS[joint_kind(model, joint)].positions)
    return [int(model.jnt_qposadr[joint]) + k for k in range(count)]


def qvel_indices(model: mujoco.MjModel, joint: int) -> list[int]:
    """Indices of a joint's velocities in qvel."""
    count = len(NUMBERS[joint_kind(model, joint)].velocities)
    return [int(model.jnt_dofadr[joint]) + k for k in range(count)]


def read_bounds(
    model: mujoco.MjModel, joints: Sequence[int], given: PositionBounds
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper bound of each position of some joints.

    Args:
        model: a compiled model.
        joints: the joints' ids.
        given: the user's bounds; the narrower of these and the model's count.

    Raises:
        UsageError: the user's bounds name another joint, or do not have the joint's number of positions.
    """
    names = [model.joint(i).name for i in joints]
    for name in given:
        if name not in names:
            raise unknown("joint in position_bounds", name, names)
    bounds = [_read_bounds(model, i, given) for i in joints]
    low, high = ([side[k] for side in bounds] for k in (0, 1))
    return np.concatenate([np.empty(0), *low]), np.concatenate([np.empty(0), *high])


def _read_bounds(model: mujoco.MjModel, joint: int, given: PositionBounds) -> tuple[np.ndarray, np.ndarray]:
    """The bounds of one joint."""
    kind, name = joint_kind(model, joint), model.joint(joint).name
    low = np.full(len(NUMBERS[kind].positions), -np.inf)
    high = -low
    if kind in ("slide", "hinge") and model.jnt_limited[joint]:
        low[:], high[:] = model.jnt_range[joint]
    elif kind == "hinge" and name not in given:
        low[:], high[:] = -TURN, TURN
    if name in given:
        size = _NUM_BOUNDS.get(kind, 0)
        if not size or any(len(side) != size for side in given[name]):
            if not size:
                what = (
                    "an unlimited hinge turns all the way round" if kind == "circle" else "it is a ball joint"
                )
                raise UsageError(
                    f"position_bounds of {name!r}: {what}, so it takes none; limit it in the model "
                    '(limited="true" range="...").'
                )
            got = " and ".join(str(len(side)) for side in given[name])
            raise UsageError(
                f"position_bounds of {name!r}: a {kind} joint takes {size} lower and {size} upper bounds, "
                f"got {got}."
            )
        low[:size] = np.maximum(low[:size], given[name][0])
        high[:size] = np.minimum(high[:size], given[name][1])
    return low, high


def read_ball_range(model: mujoco.MjModel, joint: int) -> float:
    """Largest rotation of a joint from its reference [rad]; infinite unless it is a limited ball."""
    limited = joint_kind(model, joint) == "ball" and bool(model.jnt_limited[joint])
    return float(model.jnt_range[joint, 1]) if limited else np.inf
