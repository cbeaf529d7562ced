"""The last stretch of a plan: from near the goal into it.

A sampling planner comes near a goal, hardly ever onto it. A linear quadratic regulator (LQR) about the
goal takes over from the first state it can stabilise; whether it can is found by simulating, not by theory.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

from planspace.physics.simulate import Simulator

DIFFERENCE_STEP = 1e-5
"""Half the width of the central differences that linearise the dynamics."""


@dataclass(frozen=True)
class TailConfig:
    """Settings of the regulator."""

    control_cost: float = 0.001
    """Cost of the largest control, held one step, beside the feature-weighted state cost; small is brisk."""
    velocity_cost: float = 0.1
    """Velocities cost this share of what their feature weights say; small lets the tail hurry."""
    max_steps: int = 75
    """The regulator has this many physics steps to arrive."""
    hold_steps: int = 50
    """After arriving it must still be at the goal this many physics steps later."""


class GoalRegulator:
    """An LQR about one goal, with the controls clipped to the model's range."""

    def __init__(
        self,
        simulator: Simulator,
        goal: Float[np.ndarray, " state"],
        feature_weights: Float[np.ndarray, " state"],
        config: TailConfig,
    ):
        """Linearises the dynamics at the goal and solves the Riccati equation.

        Args:
            simulator: at least 2 (state + control) simulations; its states are overwritten.
            goal: the state to reach and hold; nearly an equilibrium with zero control.
            feature_weights: how much each number of the state counts.
            config: the other settings.
        """
        self.goal, self.config = goal, config
        self._space = simulator.space
        self._low, self._high = simulator.control_low, simulator.control_high
        dynamics, actuation = linearise(simulator, goal)
        effort = np.diag(config.control_cost / self._high**2)
        cost = np.asarray(feature_weights, dtype=float) ** 2
        cost[len(self._space.joints) :] *= config.velocity_cost
        self.value = scipy.linalg.solve_discrete_are(dynamics, actuation, np.diag(cost), effort)
        gain = effort + actuation.T @ self.value @ actuation
        self.gain = np.linalg.solve(gain, actuation.T @ self.value @ dynamics)

    def control(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch control"]:
        """The regulator's control in each state."""
        return np.clip(-self._space.difference(states, self.goal) @ self.gain.T, self._low, self._high)

    def cost_to_go(self, states: Float[np.ndarray, "batch state"]) -> Float[np.ndarray, " batch"]:
        """The linear model's cost from each state; orders candidates, promises nothing."""
        delta = self._space.difference(states, self.goal)
        return np.einsum("bi,ij,bj->b", delta, self.value, delta)

    def steps_to_goal(
        self, simulator: Simulator, starts: Float[np.ndarray, "batch state"], tolerance: float
    ) -> tuple[Int[np.ndarray, " batch"], Bool[np.ndarray, " batch"]]:
        """Simulates the regulator from each state.

        Returns:
            How many physics steps until the goal region is entered, and whether it was entered with every
            state on the way in bounds.
        """
        ids = np.arange(len(starts), dtype=np.int32)
        simulator.reset(starts, ids)
        steps = np.zeros(len(starts), dtype=int)
        arrived = self._space.distance(starts, self.goal) <= tolerance
        moving = ~arrived
        for step in range(1, self.config.max_steps + 1):
            if not moving.any():
                break
            running = ids[moving]
            now = simulator.states()[running]
            simulator.step(self.control(now), ids=running)
            now = simulator.states()[running]
            steps[running] = step
            arrived[running] = self._space.distance(now, self.goal) <= tolerance
            moving[running] = ~arrived[running] & self._space.in_bounds(now)
        return steps, arrived & ~simulator.diverged()[: len(starts)]


def linearise(
    simulator: Simulator, state: Float[np.ndarray, " state"]
) -> tuple[Float[np.ndarray, "state state"], Float[np.ndarray, "state control"]]:
    """One physics step linearised at a state and zero control, by central differences.

    (`mjd_transitionFD` would do, but not with the Runge-Kutta integrator our models use.)

    Returns:
        d next / d state and d next / d control.
    """
    n, m = len(state), len(simulator.control_low)
    nudges = DIFFERENCE_STEP * np.vstack([np.eye(n + m), -np.eye(n + m)])
    ids = np.arange(len(nudges), dtype=np.int32)
    simulator.reset(state + nudges[:, :n], ids)
    simulator.step(nudges[:, n:], ids=ids)
    after = simulator.states()[: len(nudges)]
    jacobian = (after[: n + m] - after[n + m :]).T / (2 * DIFFERENCE_STEP)
    return jacobian[:, :n], jacobian[:, n:]
