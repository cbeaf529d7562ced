"""A linear regulator that takes over where it holds the goal."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from planspace.control.plant import Plant
from planspace.plan.config import RegulatorConfig
from planspace.plan.regulator import Regulator
from planspace.tasks.problem import Goal

ARRIVE_S, HOLD_S = 1.5, 0.5
"""The regulator takes over if a simulation reaches the goal within the first time and stays there for the
second [s]."""


class Takeover:
    """A regulator about the goal, and the simulation that decides whether it takes over."""

    def __init__(self, plant: Plant, goal: Goal):
        self._simulator = plant.simulator(1)
        config = replace(RegulatorConfig(), step_s=plant.control_step)
        self.goal = goal
        self.regulator = Regulator(self._simulator, goal, plant.problem.weights(plant.space), config)
        self.arrive = max(1, round(ARRIVE_S / plant.control_step))
        """Control steps within which it must reach the goal."""
        self.hold = max(1, round(HOLD_S / plant.control_step))
        """Control steps for which it must then stay there."""

    def control(self, state: Float[np.ndarray, " state"]) -> Float[np.ndarray, " control"] | None:
        """The regulator's control if it reaches and holds the goal from here; otherwise None."""
        first = now = self.regulator.control(state)
        simulator, held = self._simulator, 0
        simulator.reset(state[None])
        for step in range(self.arrive + self.hold):
            simulator.step(now[None], self.regulator.stride)
            reached = simulator.states()[0]
            if not simulator.allowed(1)[0] or simulator.diverged()[0]:
                return None
            held = held + 1 if self.goal.reached(reached) else 0
            if held >= self.hold:
                return first
            if held == 0 and step >= self.arrive:
                return None
            now = self.regulator.control(reached)
        return None
