"""Computed-torque control: drives a robot with a motor on every joint to a pose, by inverse dynamics.

    u = M(x) a + c(x),    a = 2 w (clip(w e / 2, -v_max, v_max) - v)

M is the inertia; c are all forces besides the motors', with dry friction in the direction of the move; e is
the difference to the pose, v the velocity, and w the bandwidth. If a motor cannot give its part, all
accelerations are scaled down alike.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.physics.simulator import Simulator
from planspace.plan.durations import num_steps
from planspace.plan.motors import motor
from planspace.plan.steer import steer
from planspace.tasks.problem import Goal

BANDWIDTH = 10.0
"""Bandwidth w of the controller [1/s]."""
STEP_S = 0.01
"""Time for which each control is held [s]; at least one physics step."""
MAX_S = 3.0
"""Time within which the robot must arrive [s]."""
FRACTION_OF_SPEED = 0.8
"""Largest wanted velocity, as a fraction of its bound."""

SLOW = 0.05
"""Wanted velocities well above this one are given the torque that overcomes dry friction [rad/s or m/s]."""


class ComputedTorque:
    """Drives a robot with a motor on every joint to a goal."""

    def __init__(self, simulator: Simulator):
        """Find the motor of each joint.

        Args:
            simulator: overwritten by `finish`.
        """
        model, space = simulator.model, simulator.space
        self._simulator, self._stride = simulator, num_steps(STEP_S, model)
        by_dof = {found.dof: (i, found.gain) for i in range(model.nu) if (found := motor(model, i))}
        self.fits = not space.kinematic and len(by_dof) == model.nu == model.nv == space.num_dofs
        """Whether each joint has a motor of its own and nothing else moves."""
        motors = [by_dof[dof] for dof in space.qvel_index] if self.fits else []
        self._actuators = np.array([i for i, _ in motors], dtype=int)
        self._gains = np.array([gain for _, gain in motors])
        self._friction = model.dof_frictionloss[list(space.qvel_index)]

    def finish(
        self, goal: Goal, starts: Float[np.ndarray, "batch state"]
    ) -> tuple[
        Float[np.ndarray, "batch step control"], Int[np.ndarray, " batch"], Bool[np.ndarray, " batch"]
    ]:
        """Drive to the goal from each state.

        Returns:
            The controls that were applied, one per physics step; the number of these steps until the goal
            region was entered or the state was invalid; and whether the goal region was entered with every
            state on the way allowed.
        """
        return steer(self._simulator, goal, starts, lambda ids: self._control(goal, ids), self._stride, MAX_S)

    def _control(self, goal: Goal, ids: np.ndarray) -> Float[np.ndarray, "batch control"]:
        """The controls in the current states of these simulations."""
        simulator, space = self._simulator, self._simulator.space
        states = simulator.states()[ids]
        inertias, forces = simulator.dynamics(ids)
        off = space.difference(np.broadcast_to(goal.center, states.shape), states)[:, : space.num_dofs]
        fastest = FRACTION_OF_SPEED * space.velocity_bound
        wanted = np.clip(0.5 * BANDWIDTH * off, -fastest, fastest)
        moves = np.einsum("nij,nj->ni", inertias, 2 * BANDWIDTH * (wanted - states[:, space.velocities]))
        forces += self._friction * np.tanh(wanted / SLOW)
        ends = np.stack([simulator.control_low, simulator.control_high])[:, self._actuators] * self._gains
        room = np.where(moves > 0, ends.max(axis=0) - forces, ends.min(axis=0) - forces)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.nanmin(np.where(moves == 0, 1.0, room / moves), axis=1, keepdims=True)
        controls = np.empty_like(moves)
        controls[:, self._actuators] = (np.clip(scale, 0.0, 1.0) * moves + forces) / self._gains
        return np.clip(controls, simulator.control_low, simulator.control_high)
