"""The last part of a plan, and holding its goal: a linear quadratic regulator (LQR).

A sampling planner comes near a goal but rarely reaches it. The regulator takes over from the first state that
it can stabilise. Whether it can is decided by simulation, not by theory.
"""

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

from planspace.physics.simulator import Simulator
from planspace.plan import linearise
from planspace.plan.config import RegulatorConfig
from planspace.plan.durations import num_steps
from planspace.plan.steer import steer
from planspace.tasks.problem import Goal

DISCOUNTS = (1.0, 0.995)
"""Discounts that are tried in turn. A direction that has no weight and cannot be controlled, such as the
rotation of a rod about its axis, has no finite cost, only a discounted one."""


class Regulator:
    """An LQR about the centre of one goal, with its controls clipped to their bounds."""

    def __init__(
        self,
        simulator: Simulator,
        goal: Goal,
        weights: Float[np.ndarray, " tangent"],
        config: RegulatorConfig,
    ):
        """Find the control that holds the goal, linearise there and solve the Riccati equation.

        Args:
            simulator: its states are overwritten.
            goal: the goal.
            weights: weight of each number of a tangent.
            config: the other settings.
        """
        self.goal, self.config = goal, config
        self._space = space = simulator.space
        self._low, self._high = simulator.control_low, simulator.control_high
        self.hold_control = linearise.equilibrium_control(simulator, goal.center)
        self.stride = num_steps(config.step_s, simulator.model)
        a, b = linearise.along(simulator, goal.center[None], self.hold_control[None], self.stride)
        effort = np.diag(config.control_cost / (0.5 * (self._high - self._low)) ** 2)
        cost = np.asarray(weights, dtype=float) ** 2
        cost[space.tangent_velocities] *= config.velocity_cost
        cost *= goal.weights > 0
        self.value, self.gain = np.diag(cost), np.zeros((len(effort), len(cost)))
        for discount in DISCOUNTS:  # if none works, states are ordered by distance and not steered
            try:
                value = scipy.linalg.solve_discrete_are(discount * a[0], b[0], np.diag(cost), effort)
                pull = b[0].T @ value
                gain = np.linalg.solve(effort + pull @ b[0], pull @ a[0])
            except ValueError:  # SciPy's, and with it NumPy's LinAlgError
                continue
            self.value, self.gain = value, gain
            break

    def control(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch control"]:
        """The regulator's control in each state."""
        off = self._space.difference(states, self.goal.center)
        return np.clip(self.hold_control - off @ self.gain.T, self._low, self._high)

    def cost_to_go(self, states: Float[np.ndarray, "batch state"]) -> Float[np.ndarray, " batch"]:
        """The cost from each state in the linear model; it orders candidates, no more."""
        off = self._space.difference(states, self.goal.center)
        return np.einsum("bi,ij,bj->b", off, self.value, off)

    def finish(
        self, simulator: Simulator, starts: Float[np.ndarray, "batch state"]
    ) -> tuple[
        Float[np.ndarray, "batch step control"], Int[np.ndarray, " batch"], Bool[np.ndarray, " batch"]
    ]:
        """Simulate the regulator from each state.

        Returns:
            The controls that were applied, one per physics step; the number of these steps until the goal
            region was entered or the regulator gave up; and whether the goal region was entered with every
            state on the way allowed.
        """
        return steer(
            simulator,
            self.goal,
            starts,
            lambda ids: self.control(simulator.states()[ids]),
            self.stride,
            self.config.max_s,
        )
