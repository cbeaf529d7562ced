"""Features: the Euclidean space in which the neighbours of a state are searched."""

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco.batch import Batch

from planspace.mjcf.compile import stepping
from planspace.physics.simulator import Simulator
from planspace.tasks.problem import Problem

BATCH = 512
"""States whose body positions are computed at once."""
POSITION_STAGE = int(mujoco.mjtStage.mjSTAGE_POS)


class Features:
    """The weighted numbers of a state and, if the problem names bodies, their positions in the world."""

    def __init__(self, problem: Problem, simulator: Simulator):
        """Prepare the computation.

        Args:
            problem: provides the weights and the bodies.
            simulator: provides the model, the state space and the number of threads.
        """
        model, self._space = simulator.model, simulator.space
        self._weights = problem.weights(self._space)
        self._bodies = [model.body(name).id for name, _ in problem.body_features]
        self._scale = np.repeat([weight for _, weight in problem.body_features], 3)
        if self._bodies:
            with stepping():
                self._batch = Batch(model, BATCH, simulator.threads)
            self._parts = [self._batch.bind(name) for name in ("qpos", "qvel", "act", "history")]
            self._positions = self._batch.bind("xpos")

    def __call__(self, states: Float[np.ndarray, "batch state"]) -> Float[np.ndarray, "batch feature"]:
        """Features of states: those of the state space, then the position of each body."""
        own = self._space.features(states, self._weights)
        if not self._bodies:
            return own
        return np.concatenate([own, self._body_positions(states) * self._scale], axis=1)

    def _body_positions(self, states: np.ndarray) -> Float[np.ndarray, "batch number"]:
        found = np.empty((len(states), 3 * len(self._bodies)))
        for first in range(0, len(states), BATCH):
            part = states[first : first + BATCH]
            ids = np.arange(len(part), dtype=np.int32)
            self._space.write(part, *(array[: len(part)] for array in self._parts))
            with stepping():
                self._batch.forward(ids=ids, stage=POSITION_STAGE)
            positions = np.asarray(self._positions).reshape(BATCH, -1, 3)[: len(part), self._bodies]
            found[first : first + len(part)] = positions.reshape(len(part), -1)
        return found
