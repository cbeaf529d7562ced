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
        self._regulator = Regulator(self._simulator, goal, plant.problem.weights(plant.space), config)
        self._goal = goal
        self._steps = max(1, round(ARRIVE_S / plant.control_step)), max(1, round(HOLD_S / plant.control_step))

    def control(self, state: Float[np.ndarray, " state"]) -> Float[np.ndarray, " control"] | None:
        """The regulator's control if it reaches and holds the goal from here; otherwise None."""
        first = now = self._regulator.control(state)
        simulator, held = self._simulator, 0
        simulator.reset(state[None])
        arrive, hold = self._steps
        for step in range(arrive + hold):
            simulator.step(now[None], self._regulator.stride)
            reached = simulator.states()[0]
            if not simulator.allowed(1)[0] or simulator.diverged()[0]:
                return None
            held = held + 1 if self._goal.reached(reached) else 0
            if held >= hold:
                return first
            if held == 0 and step >= arrive:
                return None
            now = self._regulator.control(reached)
        return None
