"""The simulations of the polish: linear models along a plan, and changes simulated in closed loop.

A plan is handled in blocks: each control is held for `stride` physics steps. Without feedback an unstable
plant, such as a pole or an acrobot, leaves the range of the linear model within a few steps.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from planspace.physics.simulator import Simulator
from planspace.plan import linearise
from planspace.plan.clearance import Clearance
from planspace.plan.polish_program import LinearModel
from planspace.plan.trajectory import Trajectory

FRACTIONS = np.array([1.0, 0.6, 0.35, 0.2, 0.1, 0.05, 0.02, 0.005])
"""Fractions of a change that are simulated side by side."""


class Candidate(NamedTuple):
    """A plan after a fraction of a change."""

    fraction: float
    plan: Trajectory


@dataclass(frozen=True)
class Rollout:
    """Simulations of one model, with the feedback that keeps them on a plan."""

    simulator: Simulator
    """At least as many simulations as there are `FRACTIONS`; overwritten."""
    clearance: Clearance | None
    """Measures distances between geoms; None if no contact is forbidden."""
    state_cost: Float[np.ndarray, " tangent"]
    """Weights of the states in the feedback."""
    control_cost: Float[np.ndarray, " control"]
    """Weights of the controls in the feedback."""
    stride: int
    """Physics steps per control."""

    def linear_model(self, plan: Trajectory) -> LinearModel:
        """Linearise the dynamics along a plan."""
        a, b = linearise.along(self.simulator, plan.states[:-1], plan.controls, self.stride)
        gains, _ = linearise.time_varying_lqr(a, b, self.state_cost, self.control_cost)
        if self.clearance is None:
            none = np.empty((len(plan.states), 0))
            return LinearModel(gains, linearise.sensitivities(a, b), none, none[..., None])
        distances = self.clearance.distances(plan.states)
        slopes = self.clearance.slopes(plan.states, distances)
        return LinearModel(gains, linearise.sensitivities(a, b), distances, slopes)

    def changed(
        self, plan: Trajectory, model: LinearModel, change: Float[np.ndarray, "step control"]
    ) -> list[Candidate]:
        """Apply fractions of a change to a plan; those that leave what is allowed are dropped."""
        sensitivities = model.sensitivities[: len(change) + 1, :, : change.size]
        promised = np.einsum("kij,j->ki", sensitivities, change.ravel())
        states, controls, allowed = self._closed_loop(plan, model.gains, change, promised)
        kept = np.flatnonzero(allowed)
        return [Candidate(float(FRACTIONS[i]), Trajectory(states[i], controls[i])) for i in kept]

    def in_blocks(
        self, start: Float[np.ndarray, " state"], controls: Float[np.ndarray, "step control"]
    ) -> Trajectory:
        """A plan in blocks; if a block has several steps, feedback keeps it on the states of the plan."""
        blocks = np.array_split(controls, np.arange(self.stride, len(controls), self.stride))
        means = np.stack([block.mean(axis=0) for block in blocks])
        plan = self._open_loop(start, controls)
        if self.stride == 1:
            return plan
        states = plan.states[:: self.stride][: len(means)]
        path = Trajectory(np.concatenate([states, plan.states[-1:]]), means)
        return self.followed(path)

    def followed(self, path: Trajectory) -> Trajectory:
        """The trajectory that feedback keeps on a path, whose states may jump."""
        promised = np.zeros((len(path.states), self.simulator.space.tangent_size))
        gains = self.linear_model(path).gains
        followed, applied, _ = self._closed_loop(path, gains, np.zeros_like(path.controls), promised)
        return Trajectory(followed[0], applied[0])

    def _closed_loop(
        self, plan: Trajectory, gains: np.ndarray, change: np.ndarray, promised: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Simulate fractions of a change, with feedback towards the states that the linear model promises.

        Returns:
            States, controls, and whether each simulation stayed within what is allowed.
        """
        simulator, space, count = self.simulator, self.simulator.space, len(FRACTIONS)
        ids = np.arange(count, dtype=np.int32)
        states = np.empty((count, len(change) + 1, space.size))
        controls = np.empty((count, *change.shape))
        states[:, 0] = plan.states[0]
        simulator.reset(states[:, 0], ids)
        allowed = np.ones(count, dtype=bool)
        for k in range(len(change)):
            aim = space.integrate(plan.states[k], FRACTIONS[:, None] * promised[k])
            off = space.difference(states[:, k], aim)
            wanted = plan.controls[k] + FRACTIONS[:, None] * change[k] - off @ gains[k].T
            controls[:, k] = np.clip(wanted, simulator.control_low, simulator.control_high)
            simulator.step(controls[:, k], self.stride, ids=ids)
            states[:, k + 1] = simulator.states()[:count]
            allowed &= simulator.allowed(count)
        return states, controls, allowed & ~simulator.diverged()[:count]

    def _open_loop(self, start: np.ndarray, controls: np.ndarray) -> Trajectory:
        """Simulate controls from a start, one per physics step."""
        states, ids = [start], np.array([0], dtype=np.int32)
        self.simulator.reset(start[None], ids)
        for control in controls:
            self.simulator.step(control[None], ids=ids)
            states.append(self.simulator.states()[0])
        return Trajectory(np.stack(states), controls)
