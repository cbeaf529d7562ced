"""The state space of a MuJoCo model, read off the model.

A state is the positions of the chosen joints followed by their velocities. A slide or a limited hinge
lives in a bounded interval (R), an unlimited hinge on the circle (SO(2)).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.errors import UsageError, unknown
from planspace.physics.angles import wrap

DEFAULT_VELOCITY_BOUND = 50.0
"""Velocities beyond this [m/s, rad/s] are out of bounds; the bound of the 2020 planning problems."""

_SLIDE, _HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)


@dataclass(frozen=True)
class StateSpace:
    """Positions and velocities of some joints of a model, with the geometry of each.

    With n joints a state has 2 n numbers: n positions, then n velocities in the same order.
    """

    joints: tuple[str, ...]
    """Joint names, in the model's names."""
    circular: tuple[bool, ...]
    """For each joint, whether it is an unlimited hinge: SO(2)."""
    angular: tuple[bool, ...]
    """For each joint, whether it is a hinge: its unit is rad."""
    low: Float[np.ndarray, " joint"]
    """Lower position bounds [m or rad]; minus infinity on a circle."""
    high: Float[np.ndarray, " joint"]
    """Upper position bounds [m or rad]."""
    velocity_bound: float
    """Bound on the size of every velocity [m/s or rad/s]."""
    qpos_index: tuple[int, ...]
    """Where each joint's position stands in qpos."""
    qvel_index: tuple[int, ...]
    """Where each joint's velocity stands in qvel."""

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        joints: Sequence[str],
        *,
        velocity_bound: float = DEFAULT_VELOCITY_BOUND,
    ) -> "StateSpace":
        """Reads the space of some joints off a model.

        Args:
            model: a compiled model.
            joints: which joints, by name; the others are not part of the state.
            velocity_bound: bound on the size of every velocity [m/s or rad/s].

        Raises:
            UsageError: a joint is not in the model, or is a ball or free joint.
        """
        ids = [_joint_id(model, name) for name in joints]
        limited = np.array([bool(model.jnt_limited[i]) for i in ids], dtype=bool)
        hinge = np.array([int(model.jnt_type[i]) == _HINGE for i in ids], dtype=bool)
        ranges = model.jnt_range[ids]
        return cls(
            joints=tuple(joints),
            circular=tuple((hinge & ~limited).tolist()),
            angular=tuple(hinge.tolist()),
            low=np.where(limited, ranges[:, 0], -np.inf),
            high=np.where(limited, ranges[:, 1], np.inf),
            velocity_bound=velocity_bound,
            qpos_index=tuple(int(model.jnt_qposadr[i]) for i in ids),
            qvel_index=tuple(int(model.jnt_dofadr[i]) for i in ids),
        )

    @property
    def size(self) -> int:
        """Numbers in a state."""
        return 2 * len(self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number of a state: the joints, then the joints with `vel` appended."""
        return self.joints + tuple(f"{name}vel" for name in self.joints)

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each number of a state."""
        position = tuple("rad" if angular else "m" for angular in self.angular)
        return position + tuple(f"{unit}/s" for unit in position)

    @property
    def circular_columns(self) -> tuple[int, ...]:
        """Which columns of a state are angles on a circle."""
        return tuple(i for i, circular in enumerate(self.circular) if circular)

    def difference(
        self, a: Float[np.ndarray, "*batch state"], b: Float[np.ndarray, "*batch2 state"]
    ) -> Float[np.ndarray, "*batch3 state"]:
        """A - b, the short way round where a joint is circular; the two broadcast."""
        delta = np.asarray(a - b)
        columns = list(self.circular_columns)
        delta[..., columns] = wrap(delta[..., columns])
        return delta

    def distance(
        self,
        a: Float[np.ndarray, "*batch state"],
        b: Float[np.ndarray, "*batch2 state"],
        weights: Float[np.ndarray, " state"] | float = 1.0,
    ) -> Float[np.ndarray, "*batch3"]:
        """Weighted sum of absolute differences, the goal distance of the 2020 problems."""
        return np.asarray(np.sum(np.abs(self.difference(a, b)) * weights, axis=-1))

    def features(
        self, states: Float[np.ndarray, "*batch state"], weights: Float[np.ndarray, " state"]
    ) -> Float[np.ndarray, "*batch feature"]:
        """Maps states to a Euclidean space in which nearest neighbours can be searched.

        A circular joint becomes (sin, cos), everything else stays; each scaled by its weight.
        """
        parts = []
        for i in range(self.size):
            column = states[..., i]
            if i in self.circular_columns:
                parts += [weights[i] * np.sin(column), weights[i] * np.cos(column)]
            else:
                parts.append(weights[i] * column)
        return np.stack(parts, axis=-1)

    def in_bounds(self, states: Float[np.ndarray, "*batch state"]) -> np.ndarray:
        """Whether each state is finite and within joint limits and velocity bounds."""
        n = len(self.joints)
        positions, velocities = states[..., :n], states[..., n:]
        inside = (positions >= self.low) & (positions <= self.high)
        slow = np.abs(velocities) <= self.velocity_bound
        return np.asarray(inside.all(axis=-1) & slow.all(axis=-1))  # comparisons with NaN are false

    def write(self, states: Float[np.ndarray, "*batch state"], qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Writes states into arrays shaped like MuJoCo's qpos and qvel, in place."""
        n = len(self.joints)
        qpos[..., list(self.qpos_index)] = states[..., :n]
        qvel[..., list(self.qvel_index)] = states[..., n:]

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> Float[np.ndarray, "*batch state"]:
        """Reads states from arrays shaped like MuJoCo's qpos and qvel."""
        return np.concatenate([qpos[..., list(self.qpos_index)], qvel[..., list(self.qvel_index)]], axis=-1)


def _joint_id(model: mujoco.MjModel, name: str) -> int:
    known = [model.joint(i).name for i in range(model.njnt)]
    if name not in known:
        raise unknown("joint", name, known)
    index = known.index(name)
    if int(model.jnt_type[index]) not in (_SLIDE, _HINGE):
        raise UsageError(f"joint {name!r} is a ball or free joint; slides and hinges are supported so far.")
    return index
