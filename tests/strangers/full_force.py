"""A stranger's planner: full force to the middle of the way, then full brake.

For a single slider this is the fastest way.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planspace.plan.planner import Failure, Plan
from planspace.plan.query import Query


@dataclass(frozen=True)
class FullForce:
    """Accelerate, then brake."""

    name: ClassVar[str] = "full-force"

    force: float = 1.0
    """Fraction of the largest force to use."""

    def plan(self, query: Query, rng: np.random.Generator) -> Plan | Failure:
        """Plan from rest to rest."""
        if query.space.num_dofs != 1:
            return Failure("only a single slider can be planned")
        distance = float(query.goal.center[0] - query.start[0])
        force = self.force * float(query.simulator.control_high[0])
        half = round(np.sqrt(abs(distance) / force) / query.time_step)
        signs = np.repeat([1.0, -1.0], half)[:, None]
        return Plan(np.sign(distance) * force * signs)


PLANNER = FullForce()
