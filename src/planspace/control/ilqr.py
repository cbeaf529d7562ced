"""Iterative LQR (iLQR): better controls along a planned motion, from the dynamics linearised about it.

The slope and the curvature of the distance to the goal are finite differences; where the curvature is
negative, it is taken as 0. A step of iLQR changes the controls and gives feedback on the states that this
leads to. Steps of several dampings and lengths are policies, of which the controller simulates all and keeps
the best.

Source: Tassa, Erez and Todorov 2012, Synthesis and stabilization of complex behaviors through online
trajectory optimization.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from planspace.control.costs import DistanceCost
from planspace.control.plant import Plant
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.linearise import along

NUDGE = 0.02
"""Half of the width of the differences of distances, along two directions of the tangent space at once."""
SIGNS = ((1, 1), (-1, 1), (1, -1), (-1, -1))
DAMPING, LENGTHS = (0.01, 0.1, 1.0), (1.0, 0.5, 0.25, 0.1)
LEAST_CURVATURE = 1e-9
"""Added to the second derivative by a control, which is 0 where neither distance nor effort depends on it."""
NUM_POLICIES = 1 + len(DAMPING) * len(LENGTHS)


class Policies(NamedTuple):
    """Ways to move on from a planned motion; the first keeps its controls."""

    space: StateSpace
    states: Float[np.ndarray, "time state"]
    controls: Float[np.ndarray, "step control"]
    changes: Float[np.ndarray, "policy step control"]
    """What is added to the controls."""
    gains: Float[np.ndarray, "policy step control tangent"]
    """Feedback on the difference of states."""

    def __call__(
        self, step: int, states: Float[np.ndarray, "policy state"]
    ) -> Float[np.ndarray, "policy control"]:
        """The control of each policy, which may be beyond its limits, in the state that it has reached."""
        away = self.space.difference(states, np.broadcast_to(self.states[step], states.shape))
        feedback = np.einsum("pcn,pn->pc", self.gains[:, step], away)
        return self.controls[step] + self.changes[:, step] + feedback


def policies(
    plant: Plant,
    cost: DistanceCost,
    simulator: Simulator,
    states: Float[np.ndarray, "time state"],
    controls: Float[np.ndarray, "step control"],
) -> Policies:
    """Compute `NUM_POLICIES` policies.

    Args:
        plant: what is controlled.
        cost: what is minimised.
        simulator: any number of simulations of the plant; overwritten.
        states: the states along the planned motion.
        controls: its controls.
    """
    space = plant.space
    a, b = along(simulator, states[:-1], controls, plant.physics_steps)
    slopes, curvatures = _distance_terms(space, cost, states)
    effort = cost.effort_curvature(len(controls))
    changes, gains = [np.zeros_like(controls)], [np.zeros((*controls.shape, space.tangent_size))]
    for damping in DAMPING:
        change, gain = np.zeros_like(controls), np.zeros_like(gains[0])
        value, curvature = slopes[-1], curvatures[-1]
        for t in reversed(range(len(controls))):
            by_state, by_control = a[t].T @ value, b[t].T @ value + effort * controls[t]
            both = b[t].T @ curvature @ a[t]
            twice = b[t].T @ curvature @ b[t] + np.diag(effort)
            twice += (damping * np.trace(twice) / len(effort) + LEAST_CURVATURE) * np.eye(len(effort))
            wanted = controls[t] - np.linalg.solve(twice, by_control)
            change[t] = np.clip(wanted, simulator.control_low, simulator.control_high) - controls[t]
            free = (wanted > simulator.control_low) & (wanted < simulator.control_high)
            gain[t] = -np.linalg.solve(twice, both) * free[:, None]
            value = slopes[t] + by_state + gain[t].T @ (twice @ change[t] + by_control) + both.T @ change[t]
            crossed = gain[t].T @ both
            curvature = curvatures[t] + a[t].T @ curvature @ a[t] + gain[t].T @ twice @ gain[t]
            curvature = curvature + crossed + crossed.T
        changes += [length * change for length in LENGTHS]
        gains += [gain] * len(LENGTHS)
    return Policies(space, states, controls, np.stack(changes), np.stack(gains))


def _distance_terms(
    space: StateSpace, cost: DistanceCost, states: Float[np.ndarray, "time state"]
) -> tuple[Float[np.ndarray, "time tangent"], Float[np.ndarray, "time tangent tangent"]]:
    """Slope and curvature of the distance in each state, with its weight in the cost."""
    size = space.tangent_size
    one, other = np.triu_indices(size)
    pairs = NUDGE * np.stack(
        [sign * (np.eye(size)[one] + side * np.eye(size)[other]) for sign, side in SIGNS]
    )
    found = cost.away(space.integrate(states[:, None, None], pairs[None]))
    second = (found[:, 0] + found[:, 1] - found[:, 2] - found[:, 3]) / (4 * NUDGE**2)
    curvatures = np.zeros((len(states), size, size))
    curvatures[:, one, other] = curvatures[:, other, one] = second
    values, vectors = np.linalg.eigh(curvatures)
    curvatures = np.einsum("tij,tj,tkj->tik", vectors, np.maximum(values, 0.0), vectors)
    alone = one == other  # there the first two are two nudges forward and back
    slopes = (found[:, 0, alone] - found[:, 1, alone]) / (4 * NUDGE)
    weights = cost.weights(len(states) - 1)
    return weights[:, None] * slopes, weights[:, None, None] * curvatures
