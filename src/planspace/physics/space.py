"""The state space of some joints of a MuJoCo model.

A state is the positions of the chosen joints, as in qpos, followed by their velocities, as in qvel, and by
the activations of all actuators, as in act, and the controls that delays hold back (`physics.delays`):

    slide, limited hinge    R, bounded           1 position,  1 velocity
    unlimited hinge         SO(2), an angle      1 position,  1 velocity
    ball                    SO(3), a quaternion  4 positions, 3 velocities (in the body's frame)
    free                    SE(3)                7 positions, 6 velocities (linear first)

Differences, steps and weights live in the tangent space. A tangent has one number per velocity for the
positions, followed by one number per velocity for the velocities, then the activations. A rotation is a
rotation vector [rad] in the body's frame there. All other numbers are the same in states and tangents.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from planspace.physics import quaternion
from planspace.physics.activations import NO_ACTIVATIONS, Activations, read_activations
from planspace.physics.angles import wrap
from planspace.physics.joints import (
    Kind,
    PositionBounds,
    find_joint,
    joint_kind,
    numbers_of,
    one_for_each,
    qpos_indices,
    qvel_indices,
    read_ball_range,
    read_bounds,
)
from planspace.physics.layout import Part, euclidean_features, mirrored_features, state_layout, uniform_states

DEFAULT_VELOCITY_BOUND = 50.0
"""Bound on velocities [m/s, rad/s]; that of the 2020 planning problems."""


@dataclass(frozen=True)
class StateSpace:
    """Positions and velocities of some joints of a model, its activations, and their geometry."""

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
    activations: Activations = NO_ACTIVATIONS
    """Names and ranges of the activations; empty for a kinematic space."""

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
            kinematic: leave the velocities and the activations out.

        Raises:
            UsageError: a joint is not in the model, or a bound does not fit it.
        """
        ids = [find_joint(model, name) for name in joints]
        low, high = read_bounds(model, ids, position_bounds or {})
        qvel = [k for i in ids for k in qvel_indices(model, i)]
        return cls(
            joints=tuple(joints),
            kinds=tuple(joint_kind(model, i) for i in ids),
            low=low,
            high=high,
            ball_range=tuple(read_ball_range(model, i) for i in ids),
            velocity_bound=one_for_each(velocity_bound, len(qvel)),
            qpos_index=tuple(k for i in ids for k in qpos_indices(model, i)),
            qvel_index=tuple(qvel),
            kinematic=kinematic,
            activations=NO_ACTIVATIONS if kinematic else read_activations(model),
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
    def num_activations(self) -> int:
        """Number of activations, with the controls that delays hold back; 0 if no actuator has one."""
        return len(self.activations.names)

    @property
    def size(self) -> int:
        """Number of values in a state."""
        return self.num_positions + (0 if self.kinematic else self.num_dofs) + self.num_activations

    @property
    def tangent_size(self) -> int:
        """Number of values in a tangent."""
        return self.num_dofs * (1 if self.kinematic else 2) + self.num_activations

    @property
    def velocities(self) -> slice:
        """The velocities in a state."""
        return slice(self.num_positions, self.size - self.num_activations)

    @property
    def tangent_velocities(self) -> slice:
        """The velocities in a tangent."""
        return slice(self.num_dofs, self.tangent_size - self.num_activations)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each value in a state: the joints, the joints with `vel` appended, the activations."""
        return tuple(name for name, _ in self._numbers)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each value in a state; a quaternion and an activation have none."""
        return tuple(unit for _, unit in self._numbers)

    @cached_property
    def _numbers(self) -> list[tuple[str, str]]:
        positions, velocities = numbers_of(self.joints, self.kinds)
        activations = [(name, "") for name in self.activations.names]
        return [*positions, *([] if self.kinematic else velocities), *activations]

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
        weights: Float[np.ndarray, " tangent"] | None = None,
    ) -> Float[np.ndarray, "*batch3"]:
        """Weighted sum of absolute differences, by default with `goal_weights`."""
        weights = self.goal_weights if weights is None else weights
        return np.asarray(np.sum(np.abs(self.difference(a, b)) * weights, axis=-1))

    @property
    def goal_weights(self) -> Float[np.ndarray, " tangent"]:
        """Default weights of the distance to a goal: 1, as in the 2020 problems, and 0 for activations."""
        return np.repeat([1.0, 0.0], [self.tangent_size - self.num_activations, self.num_activations])

    def default_weights(self, speed: Float[np.ndarray, " dof"]) -> Float[np.ndarray, " tangent"]:
        """Weights for the neighbour search that scale every value by its range.

        A bounded position or activation is weighted by 2 / range and a velocity by 1 / speed, so that each
        spans 2. An angle on a circle or in a rotation has weight 1 per radian: its circle has diameter 2.

        Args:
            speed: bounds on the absolute values of the velocities that are explored [m/s or rad/s].
        """
        positions = np.ones(self.num_dofs)
        for s, t in self.bounded:
            positions[t] = 2.0 / (self.high[s] - self.low[s])
        weights = [positions, 1.0 / speed, self.activations.weights]
        return positions if self.kinematic else np.concatenate(weights)

    def features(
        self, states: Float[np.ndarray, "*batch state"], weights: Float[np.ndarray, " tangent"]
    ) -> Float[np.ndarray, "*batch feature"]:
        """Map states to a Euclidean space in which nearest neighbours can be searched.

        An angle on a circle becomes (sin, cos). A quaternion gets the sign with w >= 0 and is multiplied by
        two, so that small rotations keep their length. Other values stay. Each is multiplied by its weight.
        Near w = 0 a rotation also has neighbours of the other sign: search for `mirrored` features too.
        """
        return euclidean_features(self.layout, states, weights)

    def mirrored(
        self, features: Float[np.ndarray, "*batch feature"]
    ) -> list[Float[np.ndarray, "*batch feature"]]:
        """The same features with every other combination of quaternion signs; see `features`."""
        return mirrored_features(self.layout, features)

    def sample(
        self, rng: np.random.Generator, num: int, speed: Float[np.ndarray, " dof"]
    ) -> Float[np.ndarray, "num state"]:
        """Draw states uniformly within the bounds, with velocities between `-speed` and `speed`."""
        return uniform_states(self.layout, *self.ranges(speed), rng, num)

    def ranges(
        self, speed: Float[np.ndarray, " dof"]
    ) -> tuple[Float[np.ndarray, " state"], Float[np.ndarray, " state"]]:
        """Lower and upper bound of each value in a state, with velocities between `-speed` and `speed`."""
        speed, (_, low, high, *_) = speed[: 0 if self.kinematic else None], self.activations
        return np.concatenate([self.low, -speed, low]), np.concatenate([self.high, speed, high])

    def in_bounds(self, states: Float[np.ndarray, "*batch state"]) -> Bool[np.ndarray, "*batch"]:
        """Whether each state is finite and within joint limits and velocity bounds."""
        positions, velocities = states[..., : self.num_positions], states[..., self.velocities]
        inside = ((positions >= self.low) & (positions <= self.high)).all(axis=-1)  # False for NaN
        if not self.kinematic:
            inside = inside & (np.abs(velocities) <= self.velocity_bound).all(axis=-1)
        inside = inside & np.isfinite(states[..., self.velocities.stop :]).all(axis=-1)  # MuJoCo limits them
        kinds = zip(self.kinds, self.ball_range, strict=True)
        limits = [limit for kind, limit in kinds if kind in ("ball", "free")]
        for (s, _), limit in zip(self._rotations, limits, strict=True):
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

    def write(self, states: Float[np.ndarray, "*batch state"], *parts: Any) -> None:
        """Write states into arrays shaped like MuJoCo's qpos, qvel and, if used, act and history."""
        parts[0][..., list(self.qpos_index)] = states[..., : self.num_positions]
        parts[1][..., list(self.qvel_index)] = 0.0 if self.kinematic else states[..., self.velocities]
        first, last = self.velocities.stop, self.size - self.activations.delays.size
        if first < last:
            parts[2][...] = states[..., first:last]
        if self.activations.delays.size:
            self.activations.delays.write(states[..., last:], parts[3])

    def read(self, *parts: Any) -> Float[np.ndarray, "*batch state"]:
        """Read states from arrays shaped like MuJoCo's qpos, qvel and, if used, act and history."""
        positions = parts[0][..., list(self.qpos_index)]
        if self.kinematic:
            return positions
        more = [parts[2]] if self.num_activations > self.activations.delays.size else []
        more += [self.activations.delays.read(parts[3])] if self.activations.delays.size else []
        return np.concatenate([positions, parts[1][..., list(self.qvel_index)], *more], axis=-1)

    def write_data(self, state: Float[np.ndarray, " state"], data: Any) -> None:
        """Set the state of an `MjData`; its time becomes 0 if there are delays."""
        self.write(state, data.qpos, data.qvel, data.act, data.history)
        if self.activations.delays.size:
            data.time = 0.0

    def read_data(self, data: Any) -> Float[np.ndarray, " state"]:
        """Read the state of an `MjData`."""
        return self.read(data.qpos, data.qvel, data.act, data.history)

    @cached_property
    def layout(self) -> tuple[Part, ...]:
        """The parts of a state in order: positions joint by joint, then velocities, then activations."""
        return state_layout(self.kinds, 0 if self.kinematic else self.num_dofs, self.num_activations)

    @cached_property
    def _rotations(self) -> tuple[tuple[int, int], ...]:
        return tuple((s, t) for s, t, kind in self.layout if kind == "rotation")

    @cached_property
    def _plain_states(self) -> list[int]:
        return [s for s, _, kind in self.layout if kind != "rotation"]

    @cached_property
    def _plain_tangents(self) -> list[int]:
        return [t for _, t, kind in self.layout if kind != "rotation"]

    @cached_property
    def _circular_tangents(self) -> list[int]:
        return [t for _, t, kind in self.layout if kind == "circle"]
