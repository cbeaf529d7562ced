"""A planner as a user would write it, in one file: bang-bang control of a double integrator."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planspace.plan import Failure, Plan


@dataclass(frozen=True)
class BangBang:
    """Accelerate fully towards the goal, then brake fully: the fastest way for a mass without friction."""

    name: ClassVar[str] = "bang-bang"

    acceleration: float = 10.0
    """Acceleration under the largest control [m/s^2]."""
    max_steps: int = 1000
    """Physics steps before giving up."""

    def plan(self, query, rng):
        """Follow the switching curve x = -v |v| / (2 a) of Pontryagin's maximum principle."""
        simulator, ids = query.simulator, np.zeros(1, dtype=np.int32)
        simulator.reset(query.start[None], ids)
        controls, nearest = [], np.inf
        for _ in range(self.max_steps):
            state = simulator.states()[0]
            nearest = min(nearest, float(query.goal.distance(state)))
            if query.goal.reached(state):
                return Plan(np.array(controls))
            x, v = state - query.goal.center
            before_the_curve = x + v * abs(v) / (2 * self.acceleration) < 0
            controls.append(simulator.control_high if before_the_curve else simulator.control_low)
            simulator.step(controls[-1][None], ids=ids)
        return Failure(f"not there after {self.max_steps} steps", nearest)


BANG_BANG = BangBang()


def bang_bang(query, rng):
    """`BangBang.plan` as a function."""
    return BANG_BANG.plan(query, rng)
