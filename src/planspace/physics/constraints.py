"""States that the model itself forbids: equalities torn open, and bodies inside one another."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.mjcf.compile import stepping
from planspace.physics.space import StateSpace

TOLERANCE = 1e-3
"""Largest violation of an equality in a start or a goal [m or rad]. MuJoCo's equalities are soft, and a robot
at rest violates them by less."""
MAX_DEPTH = 0.01
"""Largest depth by which bodies may overlap in a start or a goal [m]; feet on a floor overlap by less."""
ITERATIONS = 50


class Violation(NamedTuple):
    """The largest violation of an equality in a state."""

    size: float
    """How far the equality is from holding [m or rad]; 0 if the model has none."""
    equality: str
    """Its name, or its kind and number."""


class Overlap(NamedTuple):
    """The two bodies that overlap most in a state."""

    depth: float
    """How deep they are inside one another [m]; 0 if no bodies touch."""
    bodies: tuple[str, ...]
    """Their names."""


class Constraints:
    """What a model requires of the positions and velocities of a state."""

    def __init__(self, model: mujoco.MjModel, space: StateSpace):
        """Prepare the computation.

        Args:
            model: the compiled model.
            space: its state space, which has all joints of the model.
        """
        self._model, self._space, self._data = model, space, mujoco.MjData(model)
        self.has_equalities = bool(model.neq and model.eq_active0.any())

    def violation(self, state: Float[np.ndarray, " state"]) -> Violation:
        """Return the largest violation of an equality in a state."""
        if not self.has_equalities:
            return Violation(0.0, "")
        residual, _ = self._equalities(state)
        if not len(residual):
            return Violation(0.0, "")
        worst = int(np.abs(residual).argmax())
        number = int(self._data.efc_id[worst])
        kind = mujoco.mjtEq(int(self._model.eq_type[number])).name.removeprefix("mjEQ_").lower()
        return Violation(float(np.abs(residual[worst])), self._model.eq(number).name or f"{kind} {number}")

    def project(self, state: Float[np.ndarray, " state"]) -> Float[np.ndarray, " state"] | None:
        """Return the nearest state in which every equality holds, or None if none is found.

        Positions are moved by Gauss-Newton steps, and velocities that would tear an equality are removed.
        """
        if not self.has_equalities:
            return state
        space, projected = self._space, np.array(state, dtype=float)
        dofs = list(space.qvel_index)
        for _ in range(ITERATIONS):
            residual, jacobian = self._equalities(projected)
            step = np.zeros(space.tangent_size)
            if np.abs(residual).max(initial=0.0) < 0.1 * TOLERANCE:
                if not space.kinematic:
                    velocity, j = projected[space.velocities], jacobian[:, dofs]
                    step[space.tangent_velocities] = -np.linalg.pinv(j) @ j @ velocity
                return space.integrate(projected, step)
            step[: space.num_dofs] = -np.linalg.pinv(jacobian[:, dofs], rcond=1e-6) @ residual
            projected = space.integrate(projected, step)
        return None

    def overlap(self, state: Float[np.ndarray, " state"]) -> Overlap:
        """Return the largest depth by which two bodies overlap in a state."""
        self._forward(state)
        depths = [-contact.dist for contact in self._data.contact]
        if not depths or max(depths) <= 0:
            return Overlap(0.0, ())
        geoms = self._data.contact[int(np.argmax(depths))].geom
        bodies = [self._model.body(self._model.geom_bodyid[geom]).name for geom in geoms]
        return Overlap(float(max(depths)), tuple(bodies))

    def _equalities(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Violation of each row of the equalities, and its change per change of each degree of freedom."""
        self._forward(state)
        rows, data = self._data.ne, self._data
        if mujoco.mj_isSparse(self._model):
            jacobian = np.zeros((data.nefc, self._model.nv))
            mujoco.mju_sparse2dense(
                jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
            )
        else:
            jacobian = data.efc_J.reshape(data.nefc, self._model.nv)
        return data.efc_pos[:rows].copy(), jacobian[:rows].copy()

    def _forward(self, state: np.ndarray) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._space.write_data(state, self._data)
        with stepping():
            mujoco.mj_fwdPosition(self._model, self._data)
