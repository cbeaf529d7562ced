"""An extended Kalman filter: the model predicts the state, and an estimate from pictures corrects it."""

import numpy as np
from jaxtyping import Float

from planspace.control.plant import Plant
from planspace.physics.layout import tangent_errors
from planspace.plan.linearise import along, step_all

MODEL_ERROR = 0.03
"""Error of the prediction of one control step, as a fraction of the error of the estimate."""


class StateFilter:
    """Filters estimates of the state in one episode.

    Call it with each estimate, and call `predict` with each control that is applied. Errors are taken to be
    independent of each other and of those of the step before.
    """

    def __init__(self, plant: Plant, errors: Float[np.ndarray, " state"]):
        """Prepare the simulations.

        Args:
            plant: what is controlled.
            errors: root-mean-square error of each number of an estimate.
        """
        space = plant.space
        self._space, self._num_steps = space, plant.physics_steps
        self._simulator = plant.simulator(2 * (space.tangent_size + plant.model.nu))
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
        """Predict the state after a control step."""
        assert self._state is not None, "the first state was not measured"
        a, _ = along(self._simulator, self._state[None], control[None], self._num_steps)
        self._state = step_all(self._simulator, self._state[None], control[None], self._num_steps)[0]
        self._covariance = a[0] @ self._covariance @ a[0].T + MODEL_ERROR**2 * self._measured
