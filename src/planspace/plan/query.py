"""One instance of a planning problem, as planners see it."""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.metric import Metric
from planspace.plan.regulator import Regulator
from planspace.tasks.problem import Goal, Problem


@dataclass(frozen=True)
class Query:
    """One instance of a problem: controls are wanted that lead from `start` into the region of `goal`."""

    problem: Problem
    """The problem, for example its cost and the weights of neighbour search."""
    start: Float[np.ndarray, " state"]
    """Where the plan starts."""
    goal: Goal
    """Where the plan ends: `goal.distance(states)` and `goal.reached(states)`."""
    simulator: Simulator
    """Simulations that are stepped side by side. Planners may overwrite their states."""
    regulator: Regulator
    """A linear quadratic regulator about the goal, for the last part of a path."""
    metric: Metric | None = None
    """How far states are from a goal, if the user gave such a function; see `plan.metric`."""

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.simulator.model

    @property
    def space(self) -> StateSpace:
        """The state space: differences, distances, samples and bounds."""
        return self.simulator.space

    @property
    def weights(self) -> Float[np.ndarray, " tangent"]:
        """Weight of each number of a tangent in neighbour search."""
        return self.problem.weights(self.space)

    @property
    def time_step(self) -> float:
        """Duration of a physics step [s]."""
        return self.model.opt.timestep
