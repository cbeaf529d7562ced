"""The state space of a MuJoCo model, read off the model.

A state is the positions of the chosen joints, as in qpos, followed by their velocities, as in qvel:

    slide, limited hinge    R, bounded           1 position,  1 velocity
    unlimited hinge         SO(2), an angle      1 position,  1 velocity
    ball                    SO(3), a quaternion  4 positions, 3 velocities (in the body's frame)
    free                    SE(3)                7 positions, 6 velocities (linear first)

Differences, steps and weights live in the tangent space, which has one number a velocity for the positions
and as many again for the velocities: there a rotation is a rotation vector [rad] in the body's frame. For
slides and hinges states and tangents look alike.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from planspace.errors import UsageError, unknown
from planspace.physics import quaternion
from planspace.physics.angles import wrap

DEFAULT_VELOCITY_BOUND = 50.0
"""Velocities beyond this [m/s, rad/s] are out of bounds; the bound of the 2020 planning problems."""

Kind = Literal["slide", "hinge", "circle", "ball", "free"]

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
}
_POSITIONS: dict[Kind, tuple[str, ...]] = {
    "slide": ("",),
    "hinge": ("",),
    "circle": ("",),
    "ball": ("_qw", "_qx", "_qy", "_qz"),
    "free": ("_x", "_y", "_z", "_qw", "_qx", "_qy", "_qz"),
}
_VELOCITIES: dict[Kind, tuple[str, ...]] = {
    "slide": ("",),
    "hinge": ("",),
    "circle": ("",),
    "ball": ("_rx", "_ry", "_rz"),
    "free": ("_x", "_y", "_z", "_rx", "_ry", "_rz"),
}


@dataclass(frozen=True)
class StateSpace:
    """Positions and velocities of some joints of a model, with the geometry of each."""

    joints: tuple[str, ...]
    """Joint names, in the model's names."""
    kinds: tuple[Kind, ...]
    """What each joint is; `circle` is an unlimited hinge."""
    low: Float[np.ndarray, " position"]
    """Lower position bounds [m or rad]; minus infinity on a circle and in a quaternion."""
    high: Float[np.ndarray, " position"]
    """Upper position bounds [m or rad]."""
    ball_range: tuple[float, ...]
    """For each joint, how far it may turn from its reference [rad]; infinite but for a limited ball."""
    velocity_bound: Float[np.ndarray, " dof"]
    """Bound on the size of each velocity [m/s or rad/s]."""
    qpos_index: tuple[int, ...]
    """Where each position stands in qpos."""
    qvel_index: tuple[int, ...]
    """Where each velocity stands in qvel."""
    kinematic: bool = False
    """Whether a state is positions alone, moved by velocities as controls."""

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        joints: Sequence[str],
        *,
        velocity_bound: float | Sequence[float] = DEFAULT_VELOCITY_BOUND,
        position_bounds: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None,
        kinematic: bool = False,
    ) -> "StateSpace":
        """Reads the space of some joints off a model.

        Args:
            model: a compiled model.
            joints: which joints, by name; the others are not part of the state.
            velocity_bound: bound on the size of every velocity [m/s or rad/s], or one for each.
            position_bounds: bounds of joints the model leaves unlimited: low and high, one number for a
                slide, three for a free joint [m].
            kinematic: leave the velocities out.

        Raises:
            UsageError: a joint is not in the model, or a bound does not fit it.
        """
        ids = [_joint_id(model, name) for name in joints]
        kinds: tuple[Kind, ...] = tuple(_kind(model, i) for i in ids)
        bounds = position_bounds or {}
        for name in bounds:
            if name not in joints:
                raise unknown("joint in position_bounds", name, joints)
        low, high = zip(*(_bounds(model, i, bounds) for i in ids), strict=True) if ids else ((), ())
        qpos = [
            int(model.jnt_qposadr[i]) + k for i, kind in zip(ids, kinds, strict=True) for k in _span(kind)
        ]
        qvel = [
            int(model.jnt_dofadr[i]) + k
            for i, kind in zip(ids, kinds, strict=True)
            for k in range(len(_VELOCITIES[kind]))
        ]
        speed = np.asarray(velocity_bound, dtype=float)
        if speed.ndim and len(speed) != len(qvel):
            raise UsageError(
                f"velocity_bound has {len(speed)} numbers; the joints have {len(qvel)} velocities."
            )
        return cls(
            joints=tuple(joints),
            kinds=kinds,
            low=np.concatenate([np.empty(0), *low]),
            high=np.concatenate([np.empty(0), *high]),
            ball_range=tuple(_ball_range(model, i) for i in ids),
            velocity_bound=np.broadcast_to(speed, (len(qvel),)).copy(),
            qpos_index=tuple(qpos),
            qvel_index=tuple(qvel),
            kinematic=kinematic,
        )

    # --- what the numbers are ---------------------------------------------------------------------------

    @property
    def num_positions(self) -> int:
        """Numbers that give the positions."""
        return len(self.qpos_index)

    @property
    def num_dofs(self) -> int:
        """Numbers that give the velocities."""
        return len(self.qvel_index)

    @property
    def size(self) -> int:
        """Numbers in a state."""
        return self.num_positions + (0 if self.kinematic else self.num_dofs)

    @property
    def tangent_size(self) -> int:
        """Numbers in a tangent."""
        return self.num_dofs * (1 if self.kinematic else 2)

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number of a state: the joints, then the joints with `vel` appended."""
        pairs = list(zip(self.joints, self.kinds, strict=True))
        positions = [name + part for name, kind in pairs for part in _POSITIONS[kind]]
        velocities = [f"{name}{part}vel" for name, kind in pairs for part in _VELOCITIES[kind]]
        return tuple(positions if self.kinematic else positions + velocities)

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each number of a state; a quaternion has none."""
        units = {"slide": ["m"], "hinge": ["rad"], "circle": ["rad"], "ball": [""] * 4}
        units["free"] = ["m"] * 3 + [""] * 4
        rates = {"slide": ["m/s"], "hinge": ["rad/s"], "circle": ["rad/s"], "ball": ["rad/s"] * 3}
        rates["free"] = ["m/s"] * 3 + ["rad/s"] * 3
        positions = [unit for kind in self.kinds for unit in units[kind]]
        return tuple(positions + ([] if self.kinematic else [unit for k in self.kinds for unit in rates[k]]))

    @cached_property
    def circular_columns(self) -> tuple[int, ...]:
        """Which numbers of a state are angles on a circle."""
        return tuple(start for start, _, kind in self.layout if kind == "circle")

    @cached_property
    def quaternion_columns(self) -> tuple[int, ...]:
        """Where in a state each quaternion begins."""
        return tuple(start for start, _ in self._rotations)

    @cached_property
    def bounded(self) -> tuple[tuple[int, int], ...]:
        """(number of the state, number of the tangent) of each position that has bounds."""
        pairs = zip(self._plain_states, self._plain_tangents, strict=True)
        finite = np.isfinite(self.low) | np.isfinite(self.high)
        return tuple((s, t) for s, t in pairs if s < self.num_positions and finite[s])

    @cached_property
    def unbounded(self) -> tuple[int, ...]:
        """Numbers of a state that have no bounds, though they are neither on a circle nor in a rotation."""
        plain = [s for s, _, kind in self.layout if kind in ("slide", "hinge")]
        return tuple(s for s in plain if not (np.isfinite(self.low[s]) and np.isfinite(self.high[s])))

    # --- geometry ---------------------------------------------------------------------------------------

    def difference(
        self, a: Float[np.ndarray, "*batch state"], b: Float[np.ndarray, "*batch2 state"]
    ) -> Float[np.ndarray, "*batch3 tangent"]:
        """The tangent that leads from b to a, the short way round; the two broadcast."""
        a, b = np.asarray(a), np.asarray(b)
        if not self._rotations:
            delta = np.asarray(a - b)
        else:
            plain = a[..., self._plain_states] - b[..., self._plain_states]
            delta = np.empty((*plain.shape[:-1], self.tangent_size))
            delta[..., self._plain_tangents] = plain
            for s, t in self._rotations:
                back = quaternion.conjugate(b[..., s : s + 4])
                delta[..., t : t + 3] = quaternion.log(quaternion.multiply(back, a[..., s : s + 4]))
        if self.circular_columns:
            columns = self._circular_tangents
            delta[..., columns] = wrap(delta[..., columns])
        return delta

    def integrate(
        self, state: Float[np.ndarray, "*batch state"], step: Float[np.ndarray, "*batch2 tangent"]
    ) -> Float[np.ndarray, "*batch3 state"]:
        """The state one tangent further: `difference(integrate(x, d), x)` is d, if d is short."""
        if not self._rotations:
            return np.asarray(state + step)
        plain = state[..., self._plain_states] + step[..., self._plain_tangents]
        after = np.empty((*plain.shape[:-1], self.size))
        after[..., self._plain_states] = plain
        for s, t in self._rotations:
            turned = quaternion.multiply(state[..., s : s + 4], quaternion.exp(step[..., t : t + 3]))
            after[..., s : s + 4] = quaternion.normalise(turned)
        return after

    def interpolate(
        self,
        a: Float[np.ndarray, " state"],
        b: Float[np.ndarray, " state"],
        share: Float[np.ndarray, "*batch"],
    ) -> Float[np.ndarray, "*batch state"]:
        """States on the shortest way from a (share 0) to b (share 1)."""
        return self.integrate(a, np.asarray(share)[..., None] * self.difference(b, a))

    def distance(
        self,
        a: Float[np.ndarray, "*batch state"],
        b: Float[np.ndarray, "*batch2 state"],
        weights: Float[np.ndarray, " tangent"] | float = 1.0,
    ) -> Float[np.ndarray, "*batch3"]:
        """Weighted sum of absolute differences, the goal distance of the 2020 problems."""
        return np.asarray(np.sum(np.abs(self.difference(a, b)) * weights, axis=-1))

    def default_weights(self, speed: Float[np.ndarray, " dof"]) -> Float[np.ndarray, " tangent"]:
        """Weights for neighbour search: every number counts by its range.

        A bounded position weighs 2 / range and a velocity 1 / speed, so that either spans 2; an angle on a
        circle or in a rotation weighs 1 a radian, so that its circle has diameter 2.

        Args:
            speed: velocities explored lie within plus or minus these [m/s or rad/s].
        """
        positions = np.ones(self.num_dofs)
        for s, t in self.bounded:
            positions[t] = 2.0 / (self.high[s] - self.low[s])
        return positions if self.kinematic else np.concatenate([positions, 1.0 / speed])

    def features(
        self, states: Float[np.ndarray, "*batch state"], weights: Float[np.ndarray, " tangent"]
    ) -> Float[np.ndarray, "*batch feature"]:
        """Maps states to a Euclidean space in which nearest neighbours can be searched.

        A circular joint becomes (sin, cos), a quaternion the one of its two signs with w >= 0 times two
        (so that small rotations keep their length), everything else stays; each scaled by its weight. Near
        w = 0 a rotation has neighbours on the other side: `mirrored` gives the features seen from there.
        """
        parts = []
        for s, t, kind in self.layout:
            if kind == "circle":
                parts += [weights[t] * np.sin(states[..., s]), weights[t] * np.cos(states[..., s])]
            elif kind == "rotation":
                q = quaternion.nearest_sign(states[..., s : s + 4])
                parts += [2.0 * weights[t : t + 3].mean() * q[..., k] for k in range(4)]
            else:
                parts.append(weights[t] * states[..., s])
        return np.stack(parts, axis=-1)

    def mirrored(
        self, features: Float[np.ndarray, "*batch feature"]
    ) -> list[Float[np.ndarray, "*batch feature"]]:
        """The same features with other signs of the quaternions: what a search must also look at."""
        images, column = [features], 0
        for _, _, kind in self.layout:
            if kind == "rotation":
                for image in list(images):
                    flipped = image.copy()
                    flipped[..., column : column + 4] *= -1.0
                    images.append(flipped)
            column += {"circle": 2, "rotation": 4}.get(kind, 1)
        return images[1:]

    def sample(
        self, rng: np.random.Generator, num: int, speed: Float[np.ndarray, " dof"]
    ) -> Float[np.ndarray, "num state"]:
        """Draws states uniformly within the bounds, velocities within plus or minus `speed`."""
        states = np.empty((num, self.size))
        for s, t, kind in self.layout:
            if kind == "circle":
                states[:, s] = rng.uniform(-np.pi, np.pi, num)
            elif kind == "rotation":
                states[:, s : s + 4] = quaternion.sample(rng, num)
            elif s < self.num_positions:
                states[:, s] = rng.uniform(self.low[s], self.high[s], num)
            else:
                reach = speed[t - self.num_dofs]
                states[:, s] = rng.uniform(-reach, reach, num)
        return states

    def in_bounds(self, states: Float[np.ndarray, "*batch state"]) -> Bool[np.ndarray, "*batch"]:
        """Whether each state is finite and within joint limits and velocity bounds."""
        n = self.num_positions
        positions, velocities = states[..., :n], states[..., n:]
        inside = ((positions >= self.low) & (positions <= self.high)).all(axis=-1)  # false where NaN
        if not self.kinematic:
            inside = inside & (np.abs(velocities) <= self.velocity_bound).all(axis=-1)
        for (s, _), reach in zip(self._rotations, self._rotation_ranges, strict=True):
            if np.isfinite(reach):
                turned = np.linalg.norm(quaternion.log(states[..., s : s + 4]), axis=-1)
                inside = inside & (turned <= reach)
        return np.asarray(inside)

    def normalise(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch state"]:
        """The states with every quaternion at length one."""
        states = np.array(states, dtype=float)
        for s, _ in self._rotations:
            states[..., s : s + 4] = quaternion.normalise(states[..., s : s + 4])
        return states

    # --- to and from MuJoCo -----------------------------------------------------------------------------

    def write(self, states: Float[np.ndarray, "*batch state"], qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Writes states into arrays shaped like MuJoCo's qpos and qvel, in place."""
        n = self.num_positions
        qpos[..., list(self.qpos_index)] = states[..., :n]
        qvel[..., list(self.qvel_index)] = 0.0 if self.kinematic else states[..., n:]

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> Float[np.ndarray, "*batch state"]:
        """Reads states from arrays shaped like MuJoCo's qpos and qvel."""
        positions = qpos[..., list(self.qpos_index)]
        if self.kinematic:
            return positions
        return np.concatenate([positions, qvel[..., list(self.qvel_index)]], axis=-1)

    # --- where each number stands -----------------------------------------------------------------------

    @cached_property
    def layout(self) -> tuple[tuple[int, int, str], ...]:
        """(first number of the state, first of the tangent, kind) of each part, velocities one by one."""
        parts, s, t = [], 0, 0
        for kind in self.kinds:
            if kind == "free":
                parts += [(s + k, t + k, "slide") for k in range(3)]
                s, t = s + 3, t + 3
            if kind in ("free", "ball"):
                parts.append((s, t, "rotation"))
                s, t = s + 4, t + 3
            else:
                parts.append((s, t, kind))
                s, t = s + 1, t + 1
        velocities = [] if self.kinematic else [(s + k, t + k, "velocity") for k in range(self.num_dofs)]
        return tuple(parts + velocities)

    @cached_property
    def _rotations(self) -> tuple[tuple[int, int], ...]:
        return tuple((s, t) for s, t, kind in self.layout if kind == "rotation")

    @cached_property
    def _rotation_ranges(self) -> tuple[float, ...]:
        kinds = zip(self.kinds, self.ball_range, strict=True)
        return tuple(reach for kind, reach in kinds if kind in ("ball", "free"))

    @cached_property
    def _plain_states(self) -> list[int]:
        return [s for s, _, kind in self.layout if kind != "rotation"]

    @cached_property
    def _plain_tangents(self) -> list[int]:
        return [t for _, t, kind in self.layout if kind != "rotation"]

    @cached_property
    def _circular_tangents(self) -> list[int]:
        return [t for _, t, kind in self.layout if kind == "circle"]


def _joint_id(model: mujoco.MjModel, name: str) -> int:
    known = [model.joint(i).name for i in range(model.njnt)]
    if name not in known:
        raise unknown("joint", name, known)
    return known.index(name)


def _kind(model: mujoco.MjModel, joint: int) -> Kind:
    kind: Kind = _KINDS[int(model.jnt_type[joint])]
    return "circle" if kind == "hinge" and not model.jnt_limited[joint] else kind


def _span(kind: Kind) -> range:
    return range(len(_POSITIONS[kind]))


def _bounds(
    model: mujoco.MjModel, joint: int, given: Mapping[str, tuple[Sequence[float], Sequence[float]]]
) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bound of each position of a joint."""
    kind, name = _kind(model, joint), model.joint(joint).name
    low, high = np.full(len(_POSITIONS[kind]), -np.inf), np.full(len(_POSITIONS[kind]), np.inf)
    if kind in ("slide", "hinge") and model.jnt_limited[joint]:
        low[:], high[:] = model.jnt_range[joint]
    if name in given:
        size = {"slide": 1, "hinge": 1, "free": 3}.get(kind, 0)
        if not size or any(len(side) != size for side in given[name]):
            what = "unlimited hinge" if kind == "circle" else f"{kind} joint"
            raise UsageError(f"position_bounds of {name!r}: a {what} takes {size} numbers a side.")
        low[:size], high[:size] = (
            np.maximum(low[:size], given[name][0]),
            np.minimum(high[:size], given[name][1]),
        )
    return low, high


def _ball_range(model: mujoco.MjModel, joint: int) -> float:
    limited = _kind(model, joint) == "ball" and bool(model.jnt_limited[joint])
    return float(model.jnt_range[joint, 1]) if limited else np.inf
