"""Action primitives of SST: what an edge does for its duration.

An edge applies one constant control, or it servos: a proportional-derivative (PD) controller drives the
joints of the motors to a pose. For a motor on joint q with the largest control u_max,

    u = u_max clip((q_target - q - lead dq/dt) / band, -1, 1)

Actuators that are not motors on one joint, such as position servos, get a constant control in either case;
for a position servo, this control is a pose already.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.physics.simulator import Simulator
from planspace.plan.motors import motor

BAND = 0.3
"""A servo applies the largest control from this distance to its target on [rad or m]."""
LEAD_S = 0.05
"""Time by which a servo looks ahead [s]; the quotient of its gains on velocity and position."""


class Edges(NamedTuple):
    """Edges of a tree that are to be simulated."""

    actions: Float[np.ndarray, "edge control"]
    """The control of each edge; for an edge that servos, the position that each motor drives its joint to."""
    servos: Bool[np.ndarray, " edge"]
    """Whether each edge servos."""
    durations: Int[np.ndarray, " edge"]
    """Duration of each edge, in physics steps."""


class Servo:
    """Drives the joints of the motors to a pose."""

    def __init__(self, simulator: Simulator):
        """Find the motors that act on one joint.

        Args:
            simulator: overwritten by `propagate`.
        """
        self._simulator = simulator
        model, space = simulator.model, simulator.space
        columns = {} if space.kinematic else {at: i for i, at in enumerate(space.qpos_index)}
        found = [motor(model, i) for i in range(model.nu)]
        motors = [
            (i, columns[m.position], np.sign(m.gain))
            for i, m in enumerate(found)
            if m and m.position in columns
        ]
        self.motors = np.array([i for i, _, _ in motors], dtype=int)
        """Numbers of the controls that servo."""
        self._columns = np.array([column for _, column, _ in motors], dtype=int)
        tangents = {part.state: part.tangent for part in space.layout}
        self._tangents = np.array([tangents[column] for column in self._columns], dtype=int)
        self._signs = np.array([sign for _, _, sign in motors])

    def draw(self, rng: np.random.Generator, actions: Float[np.ndarray, "edge control"]) -> np.ndarray:
        """Replace the controls of motors by random positions of their joints."""
        space, aims = self._simulator.space, actions.copy()
        low, high = space.low[self._columns], space.high[self._columns]
        low, high = np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi)
        aims[:, self.motors] = rng.uniform(low, high, (len(actions), len(low)))
        return aims

    def control(
        self, states: Float[np.ndarray, "edge state"], aims: Float[np.ndarray, "edge control"]
    ) -> Float[np.ndarray, "edge control"]:
        """The control of each edge in its current state."""
        simulator, space = self._simulator, self._simulator.space
        at = states.copy()
        at[:, self._columns] = aims[:, self.motors]
        off = space.difference(at, states)[:, self._tangents]
        speed = states[:, space.num_positions + self._tangents]
        wanted = self._signs * np.clip((off - LEAD_S * speed) / BAND, -1.0, 1.0)
        low, high = simulator.control_low[self.motors], simulator.control_high[self.motors]
        controls = aims.copy()
        controls[:, self.motors] = np.clip(wanted * np.maximum(-low, high), low, high)
        return controls

    def propagate(
        self,
        starts: Float[np.ndarray, "edge state"],
        aims: Float[np.ndarray, "edge control"],
        durations: Int[np.ndarray, " edge"],
        stride: int,
    ) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Simulate edges that servo; the control changes every `stride` physics steps.

        Returns:
            The end state of each edge, whether it is valid, and its controls, one per physics step.
        """
        simulator, num = self._simulator, len(starts)
        ids = np.arange(num, dtype=np.int32)
        simulator.reset(starts, ids)
        valid, applied = (
            np.ones(num, dtype=bool),
            np.zeros((num, int(durations.max()) // stride, aims.shape[1])),
        )
        for step in range(applied.shape[1]):
            moving = ids[durations > step * stride]
            applied[moving, step] = self.control(simulator.states()[moving], aims[moving])
            simulator.step(applied[moving, step], stride, ids=moving)
            valid &= simulator.allowed(num)
        valid &= ~simulator.diverged()[:num]
        controls = [np.repeat(applied[i, : n // stride], stride, axis=0) for i, n in enumerate(durations)]
        return simulator.states()[:num], valid, controls
