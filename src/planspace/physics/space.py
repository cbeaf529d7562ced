"""The state space of some joints of a MuJoCo model.

A state is the positions of the chosen joints, as in qpos, followed by their velocities, as in qvel:

    slide, limited hinge    R, bounded           1 position,  1 velocity
    unlimited hinge         SO(2), an angle      1 position,  1 velocity
    ball                    SO(3), a quaternion  4 positions, 3 velocities (in the body's frame)
    free                    SE(3)                7 positions, 6 velocities (linear first)

Differences, steps and weights live in the tangent space. A tangent has one number per velocity for the
positions, followed by one number per velocity for the velocities. A rotation is a rotation vector [rad] in
the body's frame there. For slides and hinges, states and tangents have the same numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from planspace.errors import UsageError, unknown
from planspace.physics import quaternion
from planspace.physics.angles import wrap
from planspace.physics.joints import (
    NUMBERS,
    Kind,
    PositionBounds,
    find_joint,
    joint_kind,
    qpos_indices,
    qvel_indices,
    read_ball_range,
    read_bounds,
)
from planspace.physics.layout import Part, state_layout

DEFAULT_VELOCITY_BOUND = 50.0
"""Bound on velocities [m/s, rad/s]; that of the 2020 planning problems."""


@dataclass(frozen=True)
class StateSpace:
    """Positions and velocities of some joints of a model, and their geometry."""

    joints: tuple[str, ...]
    """Names of the joints in the model."""
    kinds: tuple[Kind, ...]
    """Kind of each joint; `circle` is an unlimited hinge."""
    low: Float[np.ndarray, " position"]
    """Lower position bounds [m or rad]; minus infinity for a circle and a quaternion."""
    high: Float[np.ndarray, " position"]
    """Upper position bounds [m or rad]."""
    ball_range: tuple[float, ...]
    """Largest rotation of each joint from its reference [rad]; infinite unless it is a limited ball."""
    velocity_bound: Float[np.ndarray, " dof"]
    """Bound on the absolute value of each velocity [m/s or rad/s]."""
    qpos_index: tuple[int, ...]
    """Index of each position in qpos."""
    qvel_index: tuple[int, ...]
    """Index of each velocity in qvel."""
    kinematic: bool = False
    """Whether a state has positions only, and velocities are the controls."""

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        joints: Sequence[str],
        *,
        velocity_bound: float | Sequence[float] = DEFAULT_VELOCITY_BOUND,
        position_bounds: PositionBounds | None = None,
        kinematic: bool = False,
    ) -> "StateSpace":
        """Read the space of some joints from a model.

        Args:
            model: a compiled model.
            joints: names of the joints; the others are not part of the state.
            velocity_bound: bound on the absolute value of every velocity [m/s or rad/s], or one for each.
            position_bounds: bounds of joints that the model leaves unlimited: low and high, one number for a
                slide, three for a free joint [m].
            kinematic: leave the velocities out.

        Raises:
            UsageError: a joint is not in the model, or a bound does not fit it.
        """
        ids = [find_joint(model, name) for name in joints]
        given = position_bounds or {}
        for name in given:
            if name not in joints:
                raise unknown("joint in position_bounds", name, joints)
        bounds = [read_bounds(model, i, given) for i in ids]
        qvel = [k for i in ids for k in qvel_indices(model, i)]
        return cls(
            joints=tuple(joints),
            kinds=tuple(joint_kind(model, i) for i in ids),
            low=np.concatenate([np.empty(0), *(low for low, _ in bounds)]),
            high=np.concatenate([np.empty(0), *(high for _, high in bounds)]),
            ball_range=tuple(read_ball_range(model, i) for i in ids),
            velocity_bound=_one_for_each(velocity_bound, len(qvel)),
            qpos_index=tuple(k for i in ids for k in qpos_indices(model, i)),
            qvel_index=tuple(qvel),
            kinematic=kinematic,
        )

    @property
    def num_positions(self) -> int:
        """Number of positions; a rotation has four."""
        return len(self.qpos_index)

    @property
    def num_dofs(self) -> int:
        """Number of velocities; a rotation has three."""
        return len(self.qvel_index)

    @property
    def size(self) -> int:
        """Number of values in a state."""
        return self.num_positions + (0 if self.kinematic else self.num_dofs)

    @property
    def tangent_size(self) -> int:
        """Number of values in a tangent."""
        return self.num_dofs * (1 if self.kinematic else 2)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each value in a state: the joints, then the joints with `vel` appended."""
        pairs = list(zip(self.joints, self.kinds, strict=True))
        positions = [name + part for name, kind in pairs for part in NUMBERS[kind].positions]
        velocities = [f"{name}{part}vel" for name, kind in pairs for part in NUMBERS[kind].velocities]
        return tuple(positions if self.kinematic else positions + velocities)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each value in a state; a quaternion has none."""
        positions = [unit for kind in self.kinds for unit in NUMBERS[kind].position_units]
        velocities = [unit for kind in self.kinds for unit in NUMBERS[kind].velocity_units]
        return tuple(positions if self.kinematic else positions + velocities)

    @cached_property
    def circular_columns(self) -> tuple[int, ...]:
        """Indices of the values in a state that are angles on a circle."""
        return tuple(part.state for part in self.layout if part.kind == "circle")

    @cached_property
    def quaternion_columns(self) -> tuple[int, ...]:
        """Index in a state at which each quaternion begins."""
        return tuple(start for start, _ in self._rotations)

    @cached_property
    def bounded(self) -> tuple[tuple[int, int], ...]:
        """(index in a state, index in a tangent) of each position that has bounds."""
        pairs = zip(self._plain_states, self._plain_tangents, strict=True)
        finite = np.isfinite(self.low) | np.isfinite(self.high)
        return tuple((s, t) for s, t in pairs if s < self.num_positions and finite[s])

    @cached_property
    def unbounded(self) -> tuple[int, ...]:
        """Indices of positions without bounds that are neither on a circle nor part of a rotation."""
        plain = [s for s, _, kind in self.layout if kind in ("slide", "hinge")]
        return tuple(s for s in plain if not (np.isfinite(self.low[s]) and np.isfinite(self.high[s])))

    # --- geometry ---------------------------------------------------------------------------------------

    def difference(
        self, a: Float[np.ndarray, "*batch state"], b: Float[np.ndarray, "*batch2 state"]
    ) -> Float[np.ndarray, "*batch3 tangent"]:
        """The tangent that leads from b to a the short way round; a and b broadcast."""
        a, b = np.asarray(a), np.asarray(b)
        if not self._rotations:
            delta = np.asarray(a - b)
        else:
            plain = a[..., self._plain_states] - b[..., self._plain_states]
            delta = np.empty((*plain.shape[:-1], self.tangent_size))
            delta[..., self._plain_tangents] = plain
            for s, t in self._rotations:
                inverse = quaternion.conjugate(b[..., s : s + 4])
                delta[..., t : t + 3] = quaternion.log(quaternion.multiply(inverse, a[..., s : s + 4]))
        if self.circular_columns:
            columns = self._circular_tangents
            delta[..., columns] = wrap(delta[..., columns])
        return delta

    def integrate(
        self, state: Float[np.ndarray, "*batch state"], step: Float[np.ndarray, "*batch2 tangent"]
    ) -> Float[np.ndarray, "*batch3 state"]:
        """The state that a tangent leads to: `difference(integrate(x, d), x)` is d if d is short."""
        if not self._rotations:
            return np.asarray(state + step)
        plain = state[..., self._plain_states] + step[..., self._plain_tangents]
        after = np.empty((*plain.shape[:-1], self.size))
        after[..., self._plain_states] = plain
        for s, t in self._rotations:
            rotated = quaternion.multiply(state[..., s : s + 4], quaternion.exp(step[..., t : t + 3]))
            after[..., s : s + 4] = quaternion.normalise(rotated)
        return after

    def interpolate(
        self,
        a: Float[np.ndarray, " state"],
        b: Float[np.ndarray, " state"],
        fraction: Float[np.ndarray, "*batch"],
    ) -> Float[np.ndarray, "*batch state"]:
        """States on the shortest path from a (fraction 0) to b (fraction 1)."""
        return self.integrate(a, np.asarray(fraction)[..., None] * self.difference(b, a))

    def distance(
        self,
        a: Float[np.ndarray, "*batch state"],
        b: Float[np.ndarray, "*batch2 state"],
        weights: Float[np.ndarray, " tangent"] | float = 1.0,
    ) -> Float[np.ndarray, "*batch3"]:
        """Weighted sum of absolute differences, the goal distance of the 2020 problems."""
        return np.asarray(np.sum(np.abs(self.difference(a, b)) * weights, axis=-1))

    def default_weights(self, speed: Float[np.ndarray, " dof"]) -> Float[np.ndarray, " tangent"]:
        """Weights for the neighbour search that scale every value by its range.

        A bounded position is weighted by 2 / range and a velocity by 1 / speed, so that each spans 2. An
        angle on a circle or in a rotation has weight 1 per radian, so that its circle has diameter 2.

        Args:
            speed: bounds on the absolute values of the velocities that are explored [m/s or rad/s].
        """
        positions = np.ones(self.num_dofs)
        for s, t in self.bounded:
            positions[t] = 2.0 / (self.high[s] - self.low[s])
        return positions if self.kinematic else np.concatenate([positions, 1.0 / speed])

    def features(
        self, states: Float[np.ndarray, "*batch state"], weights: Float[np.ndarray, " tangent"]
    ) -> Float[np.ndarray, "*batch feature"]:
        """Map states to a Euclidean space in which nearest neighbours can be searched.

        An angle on a circle becomes (sin, cos). A quaternion gets the sign with w >= 0 and is multiplied by
        two, so that small rotations keep their length. Other values stay. Each is multiplied by its weight.
        Near w = 0 a rotation also has neighbours of the other sign: search for `mirrored` features too.
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
        """The same features with every other combination of quaternion signs; see `features`."""
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
        """Draw states uniformly within the bounds, with velocities between `-speed` and `speed`."""
        states = np.empty((num, self.size))
        for s, t, kind in self.layout:
            if kind == "circle":
                states[:, s] = rng.uniform(-np.pi, np.pi, num)
            elif kind == "rotation":
                states[:, s : s + 4] = quaternion.sample(rng, num)
            elif s < self.num_positions:
                states[:, s] = rng.uniform(self.low[s], self.high[s], num)
            else:
                bound = speed[t - self.num_dofs]
                states[:, s] = rng.uniform(-bound, bound, num)
        return states

    def in_bounds(self, states: Float[np.ndarray, "*batch state"]) -> Bool[np.ndarray, "*batch"]:
        """Whether each state is finite and within joint limits and velocity bounds."""
        positions, velocities = np.split(states, [self.num_positions], axis=-1)
        inside = ((positions >= self.low) & (positions <= self.high)).all(axis=-1)  # False for NaN
        if not self.kinematic:
            inside = inside & (np.abs(velocities) <= self.velocity_bound).all(axis=-1)
        for (s, _), limit in zip(self._rotations, self._rotation_ranges, strict=True):
            if np.isfinite(limit):
                angle = np.linalg.norm(quaternion.log(states[..., s : s + 4]), axis=-1)
                inside = inside & (angle <= limit)
        return np.asarray(inside)

    def normalise(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch state"]:
        """The states with every quaternion scaled to length one."""
        states = np.array(states, dtype=float)
        for s, _ in self._rotations:
            states[..., s : s + 4] = quaternion.normalise(states[..., s : s + 4])
        return states

    # --- reading from and writing to MuJoCo -------------------------------------------------------------

    def write(self, states: Float[np.ndarray, "*batch state"], qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Write states into arrays shaped like MuJoCo's qpos and qvel, in place."""
        n = self.num_positions
        qpos[..., list(self.qpos_index)] = states[..., :n]
        qvel[..., list(self.qvel_index)] = 0.0 if self.kinematic else states[..., n:]

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> Float[np.ndarray, "*batch state"]:
        """Read states from arrays shaped like MuJoCo's qpos and qvel."""
        positions = qpos[..., list(self.qpos_index)]
        if self.kinematic:
            return positions
        return np.concatenate([positions, qvel[..., list(self.qvel_index)]], axis=-1)

    @cached_property
    def layout(self) -> tuple[Part, ...]:
        """The parts of a state in order: positions joint by joint, then each velocity."""
        return state_layout(self.kinds, 0 if self.kinematic else self.num_dofs)

    @cached_property
    def _rotations(self) -> tuple[tuple[int, int], ...]:
        return tuple((s, t) for s, t, kind in self.layout if kind == "rotation")

    @cached_property
    def _rotation_ranges(self) -> tuple[float, ...]:
        pairs = zip(self.kinds, self.ball_range, strict=True)
        return tuple(limit for kind, limit in pairs if kind in ("ball", "free"))

    @cached_property
    def _plain_states(self) -> list[int]:
        return [s for s, _, kind in self.layout if kind != "rotation"]

    @cached_property
    def _plain_tangents(self) -> list[int]:
        return [t for _, t, kind in self.layout if kind != "rotation"]

    @cached_property
    def _circular_tangents(self) -> list[int]:
        return [t for _, t, kind in self.layout if kind == "circle"]


def _one_for_each(velocity_bound: float | Sequence[float], num: int) -> Float[np.ndarray, " dof"]:
    bound = np.asarray(velocity_bound, dtype=float)
    if bound.ndim and len(bound) != num:
        raise UsageError(f"velocity_bound has {len(bound)} numbers; the joints have {num} velocities.")
    return np.broadcast_to(bound, (num,)).copy()
