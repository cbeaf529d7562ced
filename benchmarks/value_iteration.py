"""Shortest times to a goal region from all states around it, by value iteration on a grid.

Notation: delta = state - goal, with angles on the circle. Each number of delta has its own axis. Node i lies
at delta = a sinh(i / c), so nodes are a / c apart at the goal and |delta| / c far from it: the goal region is
small, and a uniform grid that resolves it would have too many nodes.

Each node takes one Runge-Kutta step of its own length with each extreme control, of up to `CELLS` cells:
every step interpolates, and with steps of about one cell the times of the pendulum were 18 % too long. V is
the time of a continuous motion whose control may change at any time, because V is linear between nodes.
Sweeps go on until no value changes:

    V(x) = 0 in the goal region, else min over u of dt + V(x after dt), or `LONGEST` if that state is invalid.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

LONGEST = 4.0
"""The value where the goal cannot be reached, or only later [s]."""
STEPS_S = (0.00125, 0.0025, 0.005, 0.01, 0.02)
"""Lengths of a node's step [s]."""
CELLS = 10.0
"""A node's step is the longest one of `STEPS_S` that moves by at most this many cells along each axis."""
TOLERANCE_S, MAX_SWEEPS = 1e-3, 500

Step = Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]]
"""(states [n, state], controls [n, control], duration) -> states [n, state], whether each is valid [n]."""
Difference = Callable[[np.ndarray], np.ndarray]
"""states [n, state] -> states minus the goal [n, state]."""


class Axis(NamedTuple):
    """The nodes along one number of delta."""

    a: float
    c: float
    first: int
    """i of the first node."""
    count: int
    circle: bool = False
    """Whether the first and the last node are the same state: -pi and pi."""

    def cells(self, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of the node below each delta, and the place of delta on the way to the next (0 to 1)."""
        i = (self.c * np.arcsinh(delta / self.a) - self.first).astype(int)
        low, nodes = np.clip(i, 0, self.count - 2), self.nodes
        return low, np.clip((delta - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)

    @property
    def nodes(self) -> np.ndarray:
        """Delta at each node."""
        return self.a * np.sinh((self.first + np.arange(self.count)) / self.c)


def make_axis(low: float, high: float, width: float, c: float) -> Axis:
    """Return an axis from `low` to `high`, which enclose 0, with nodes `width` apart at 0."""
    a = width * c
    first, last = (int(np.floor(c * np.arcsinh(low / a))), int(np.ceil(c * np.arcsinh(high / a))))
    return Axis(a, c, first, last - first + 1)


def circle_axis(width: float, c: float) -> Axis:
    """Return an axis from -pi to pi with nodes about `width` apart at 0; its ends are nodes."""
    last = round(c * np.arcsinh(np.pi / (width * c)))
    return Axis(np.pi / np.sinh(last / c), c, -last, 2 * last + 1, circle=True)


class Grid(NamedTuple):
    """Nodes around a goal."""

    axes: tuple[Axis, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of nodes along each axis."""
        return tuple(axis.count for axis in self.axes)

    @property
    def deltas(self) -> Float[np.ndarray, "node state"]:
        """Delta at each node."""
        mesh = np.meshgrid(*(axis.nodes for axis in self.axes), indexing="ij")
        return np.stack([m.ravel() for m in mesh], axis=1)

    @property
    def offsets(self) -> np.ndarray:
        """Distance in the flat array from a cell's first corner to each of its corners."""
        strides = np.cumprod((1, *self.shape[:0:-1]))[::-1]
        return np.array([np.dot(corner, strides) for corner in product((0, 1), repeat=len(self.axes))])

    def cells(
        self, delta: Float[np.ndarray, "node state"]
    ) -> tuple[Int[np.ndarray, " node"], Float[np.ndarray, "node state"]]:
        """Number of the first corner of the cell of each delta, and its place in the cell, from 0 to 1."""
        found = [axis.cells(d) for axis, d in zip(self.axes, delta.T, strict=True)]
        low, part = zip(*found, strict=True)
        corner = np.ravel_multi_index(low, self.shape)
        return corner.astype(np.int32), np.stack(part, axis=1).astype(np.float32)


class Values(NamedTuple):
    """The shortest times to a goal."""

    grid: Grid
    difference: Difference
    value: Float[np.ndarray, " node"]

    def __call__(self, states: Float[np.ndarray, "row state"]) -> Float[np.ndarray, " row"]:
        """Interpolate the time from each state [s]; it does not know that it is 0 in the goal region."""
        corner, part = self.grid.cells(self.difference(states))
        return np.asarray(_interpolate(self.value, self.grid.offsets, corner, part))


def iterate(
    grid: Grid,
    states: Float[np.ndarray, "node state"],
    difference: Difference,
    reached: Callable[[np.ndarray], np.ndarray],
    step: Step,
    controls: Float[np.ndarray, "control number"],
) -> Values:
    """Compute the shortest time from each node.

    Args:
        grid: the nodes.
        states: the valid state at each node, or the one that is nearest to it.
        difference: subtracts the goal from states.
        reached: whether states [n, state] are in the goal region [n].
        step: moves states.
        controls: the controls to choose from.
    """
    lengths = step_lengths(grid, states, difference, step, controls)
    offsets, goal = grid.offsets, reached(states)
    corners, parts, fixed = [], [], []
    for control in controls:
        ends, valid = _move(states, control, lengths, step)
        corner, part = grid.cells(difference(ends))
        corners.append(corner)
        parts.append(part)
        fixed.append(np.where(reached(ends), 0.0, np.where(valid, np.nan, LONGEST)).astype(np.float32))
    value = _solve(
        jnp.where(goal, 0.0, LONGEST).astype(jnp.float32),
        jnp.asarray(lengths, jnp.float32),
        jnp.asarray(np.stack(corners)),
        jnp.asarray(np.stack(parts)),
        jnp.asarray(np.stack(fixed)),
        tuple(int(o) for o in offsets),
    )
    return Values(grid, difference, np.asarray(value))


def step_lengths(
    grid: Grid,
    states: Float[np.ndarray, "node state"],
    difference: Difference,
    step: Step,
    controls: Float[np.ndarray, "control number"],
) -> Float[np.ndarray, " node"]:
    """The length of each node's step [s]."""
    delta, fastest = difference(states), np.zeros(len(states))
    for control in controls:
        ends, _ = step(states, np.tile(control, (len(states), 1)), STEPS_S[0])
        speed = np.abs(difference(ends) - delta) / STEPS_S[0]
        for axis, d, v in zip(grid.axes, delta.T, speed.T, strict=True):
            fastest = np.maximum(fastest, axis.c * v / np.hypot(d, axis.a))
    allowed = CELLS / np.maximum(fastest, 1e-9)
    return np.array(STEPS_S)[np.maximum(np.searchsorted(STEPS_S, allowed, side="right") - 1, 0)]


def _move(
    states: np.ndarray, control: np.ndarray, lengths: np.ndarray, step: Step
) -> tuple[np.ndarray, Bool[np.ndarray, " node"]]:
    ends, valid = np.empty_like(states), np.empty(len(states), dtype=bool)
    for length in np.unique(lengths):
        rows = np.flatnonzero(lengths == length)
        ends[rows], valid[rows] = step(states[rows], np.tile(control, (len(rows), 1)), float(length))
    return ends, valid


def _interpolate(value: Any, offsets: Sequence[int], corner: Any, part: Any) -> Any:
    total = 0.0
    for offset, ends in zip(offsets, product((0, 1), repeat=part.shape[-1]), strict=True):
        weight = 1.0
        for k, end in enumerate(ends):
            weight = weight * (part[..., k] if end else 1.0 - part[..., k])
        total = total + weight * value[corner + offset]
    return total


@partial(jax.jit, static_argnames="offsets")
def _solve(
    value: Array, lengths: Array, corners: Array, parts: Array, fixed: Array, offsets: tuple[int, ...]
) -> Array:
    """Sweep until no value changes by more than `TOLERANCE_S`."""

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        old, _, count = carry
        best = jnp.full_like(old, LONGEST)
        for corner, part, known in zip(corners, parts, fixed, strict=True):
            after = jnp.where(jnp.isnan(known), _interpolate(old, offsets, corner, part), known)
            best = jnp.minimum(best, lengths + after)
        new = jnp.where(value == 0.0, 0.0, best)
        return new, jnp.abs(new - old).max(), count + 1

    def unfinished(carry: tuple[Array, Array, Array]) -> Array:
        return (carry[1] > TOLERANCE_S) & (carry[2] < MAX_SWEEPS)

    return jax.lax.while_loop(unfinished, sweep, (value, jnp.array(jnp.inf), jnp.array(0)))[0]
