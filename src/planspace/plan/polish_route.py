"""A way between two positions on which geoms that must not touch stay apart: a tree of random positions.

It is the guess of a repair where a straight line is blocked. Velocities and controls play no part.
"""

import numpy as np
from jaxtyping import Float

from planspace.physics.space import StateSpace
from planspace.plan.clearance import Clearance
from planspace.plan.polish_program import CLEARANCE

ROUNDS = 400
"""Rounds before giving up."""
SAMPLES = 64
"""Positions drawn in each round."""
REACH = 0.4
"""Longest step of the tree, in the weighted sum of differences."""
POINTS = 12
"""Points at which a step of the tree is checked."""
SHORTCUTS = 100
"""Pairs of points of a way between which a straight line is tried."""


class Route:
    """Searches ways in the positions of a space."""

    def __init__(self, clearance: Clearance, space: StateSpace, weights: Float[np.ndarray, " tangent"]):
        """Prepare a search.

        Args:
            clearance: measures the distances of geoms.
            space: the space; velocities of the ways are zero.
            weights: weight of each number of a tangent in distances.
        """
        self.clearance, self.space, self.weights = clearance, space, weights

    def find(
        self, start: Float[np.ndarray, " state"], end: Float[np.ndarray, " state"]
    ) -> Float[np.ndarray, "point state"] | None:
        """The corners of a way from start to end; None if none is found."""
        rng = np.random.default_rng(np.concatenate([start, end]).view(np.uint64))
        states, parents = self._at_rest(start)[None], [-1]
        end, still = self._at_rest(end), np.full(self.space.num_dofs, 1e-9)
        new = np.array([0])
        for _ in range(ROUNDS):
            arrived = new[self._free(states[new], np.broadcast_to(end, states[new].shape))]
            if len(arrived):
                return self._shortened(np.array([*self._back(states, parents, int(arrived[0])), end]), rng)
            targets = self._at_rest(self.space.sample(rng, SAMPLES, still))
            nearest = self._lengths(states[None], targets[:, None]).argmin(axis=1)
            way = self.space.difference(targets, states[nearest])
            scale = np.minimum(1.0, REACH / np.maximum(np.abs(way) @ self.weights, 1e-9))
            ends = self.space.integrate(states[nearest], scale[:, None] * way)
            free = self._free(states[nearest], ends)
            new = len(states) + np.arange(free.sum())
            states = np.concatenate([states, ends[free]])
            parents += nearest[free].tolist()
        return None

    def _at_rest(self, states: np.ndarray) -> np.ndarray:
        states = states.copy()
        states[..., self.space.num_positions :] = 0.0
        return states

    def _lengths(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.abs(self.space.difference(b, a)) @ self.weights

    def _free(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Whether the straight line between each pair of states keeps its distances."""
        fractions = np.linspace(0.0, 1.0, POINTS)[1:, None]
        lines = self.space.integrate(
            starts[:, None], fractions * self.space.difference(ends, starts)[:, None]
        )
        distances = self.clearance.distances(lines.reshape(-1, self.space.size))
        apart = (distances > CLEARANCE).all(axis=1).reshape(len(starts), POINTS - 1)
        return np.asarray(apart.all(axis=1))

    def _back(self, states: np.ndarray, parents: list[int], node: int) -> list[np.ndarray]:
        way = []
        while node >= 0:
            way.append(states[node])
            node = parents[node]
        return way[::-1]

    def _shortened(self, way: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        for _ in range(SHORTCUTS):
            if len(way) < 3:
                break
            i, j = np.sort(rng.choice(len(way), 2, replace=False))
            if j > i + 1 and self._free(way[i][None], way[j][None])[0]:
                way = np.concatenate([way[: i + 1], way[j:]])
        return way
