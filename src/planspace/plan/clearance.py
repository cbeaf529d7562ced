"""Distances between geoms that must not touch, and how they change with the positions.

MuJoCo's distance sensors measure them, on a separate model, so that simulation does not become slower. Slopes
are finite differences, computed only where two geoms are close.
"""

import itertools

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco.batch import Batch

from planspace.mjcf.compile import open_spec, watch_pair
from planspace.physics.space import StateSpace
from planspace.tasks.problem import Problem

REACH = 0.2
"""Largest distance that is measured [m]; larger ones count as this."""
NEAR = 0.1
"""Slopes are computed for states in which some pair is closer than this [m]."""
NUDGE = 1e-5
MAX_PAIRS = 200
"""With more pairs than this, distances are not kept; contacts are only checked."""
BATCH = 512


class Clearance:
    """Distances between the geoms that must not touch in a problem."""

    def __init__(self, problem: Problem, space: StateSpace, *, threads: int = 0):
        """Build the model with sensors.

        Args:
            problem: a problem with forbidden contacts.
            space: its state space.
            threads: physics threads; 0 uses all CPUs.
        """
        with open_spec(problem.source) as spec:
            for number, geom in enumerate(spec.geoms):
                geom.name = geom.name or f"planspace_geom_{number}"
            pairs = problem.validity.pairs or collidable_pairs(spec.compile())
            self.num_pairs = len(pairs) if len(pairs) <= MAX_PAIRS else 0
            for number, pair in enumerate(pairs[: self.num_pairs]):
                name, kind = f"planspace_distance_{number}", mujoco.mjtSensor.mjSENS_GEOMDIST
                watch = spec.add_sensor(name=name, type=kind, cutoff=REACH)
                watch_pair(spec, watch, pair)
            model = spec.compile()
        self._space = space
        self._batch = Batch(model, BATCH, threads)
        self._sensors = self._batch.bind("sensordata")
        self._parts = [self._batch.bind(name) for name in ("qpos", "qvel", "act", "history")]

    def distances(self, states: Float[np.ndarray, "step state"]) -> Float[np.ndarray, "step pair"]:
        """The distance of every pair in each state [m]: negative if they overlap, at most `REACH`."""
        found = np.empty((len(states), self.num_pairs))
        if not self.num_pairs:
            return found
        for first in range(0, len(states), BATCH):
            part = states[first : first + BATCH]
            ids = np.arange(len(part), dtype=np.int32)
            self._space.write(part, *(array[: len(part)] for array in self._parts))
            self._batch.forward(ids=ids, stage=int(mujoco.mjtStage.mjSTAGE_POS))
            found[first : first + BATCH] = self._sensors[: len(part), -self.num_pairs :]
        return found

    def slopes(
        self, states: Float[np.ndarray, "step state"], distances: Float[np.ndarray, "step pair"]
    ) -> Float[np.ndarray, "step pair dof"]:
        """Change of each distance per change of each position [m/rad or m/m]; 0 where nothing is close."""
        space, n = self._space, self._space.num_dofs
        slopes = np.zeros((*distances.shape, n))
        near = np.flatnonzero((distances < NEAR).any(axis=1))
        if len(near) == 0:
            return slopes
        nudges = np.zeros((n, space.tangent_size))
        nudges[:, :n] = NUDGE * np.eye(n)
        moved = space.integrate(states[near][:, None], nudges[None])
        after = self.distances(moved.reshape(-1, space.size)).reshape(len(near), n, -1)
        slopes[near] = ((after - distances[near][:, None]) / NUDGE).transpose(0, 2, 1)
        return slopes


def collidable_pairs(model: mujoco.MjModel) -> tuple[tuple[str, str], ...]:
    """The pairs of geoms that can collide in MuJoCo, given their bits, bodies, parents and exclusions."""
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    weld, parent = model.body_weldid, model.body_parentid

    def collide(a: int, b: int) -> bool:
        first, second = weld[model.geom_bodyid[a]], weld[model.geom_bodyid[b]]
        if first == second or (int(model.geom_bodyid[a]), int(model.geom_bodyid[b])) in excluded:
            return False
        in_line = weld[parent[first]] == second or weld[parent[second]] == first
        if first and second and in_line:
            return False
        return bool(
            model.geom_contype[a] & model.geom_conaffinity[b]
            or model.geom_contype[b] & model.geom_conaffinity[a]
        )

    pairs = itertools.combinations(range(model.ngeom), 2)
    return tuple((model.geom(a).name, model.geom(b).name) for a, b in pairs if collide(a, b))
