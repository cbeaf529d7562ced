"""An extended Kalman filter: the model predicts the state, and an estimate from pictures corrects it."""

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.physics.layout import tangent_errors
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.linearise import along, step_all

MODEL_ERROR = 0.03
"""Error of the prediction of one control step, as a fraction of the error of the estimate."""


class StateFilter:
    """Filters estimates of the state in one episode.

    Call it with each estimate, and call `predict` with each control that is applied. Errors are taken to be
    independent of each other and of those of the step before.
    """

    def __init__(
        self, model: mujoco.MjModel, space: StateSpace, num_steps: int, errors: Float[np.ndarray, " state"]
    ):
        """Prepare the simulations.

        Args:
            model: the compiled model.
            space: its state space.
            num_steps: physics steps for which a control is held.
            errors: root-mean-square error of each number of an estimate.
        """
        self._space, self._num_steps = space, num_steps
        self._simulator = Simulator(model, space, 2 * (space.tangent_size + model.nu), threads=1)
        self._measured = np.diag(tangent_errors(space.layout, errors) ** 2)
        self._state: np.ndarray | None = None

    def __call__(self, estimate: Float[np.ndarray, " state"]) -> Float[np.ndarray, " state"]:
        """Correct the prediction by an estimate of the present state, and return the filtered state."""
        if self._state is None:
            self._state, self._covariance = estimate, self._measured
            return estimate
        predicted = self._covariance
        gain = np.linalg.solve(predicted + self._measured, predicted).T
        self._state = self._space.integrate(self._state, gain @ self._space.difference(estimate, self._state))
        self._covariance = predicted - gain @ predicted
        return self._state

    def predict(self, control: Float[np.ndarray, " control"]) -> None:
        """Predict the state after a control step; the control is clipped to its limits."""
        assert self._state is not None, "the first state was not measured"
        control = np.clip(control, self._simulator.control_low, self._simulator.control_high)
        a, _ = along(self._simulator, self._state[None], control[None], self._num_steps)
        self._state = step_all(self._simulator, self._state[None], control[None], self._num_steps)[0]
        self._covariance = a[0] @ self._covariance @ a[0].T + MODEL_ERROR**2 * self._measured
