"""What is controlled: a task, and the goal that its planning problem gives it."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from planspace.errors import UsageError
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.linearise import at_rest
from planspace.tasks.action_repeat import repeat_actions
from planspace.tasks.catalog import find_task
from planspace.tasks.problem import Goal, Problem
from planspace.tasks.problem_file import load_problem
from planspace.tasks.problem_task import task_of_problem
from planspace.tasks.task import Task

NUM_STARTS = 32
"""Starts whose mean distance to the goal is the unit of costs."""


@dataclass(frozen=True)
class Plant:
    """A task and its planning problem."""

    task: Task
    """Where episodes start, what is rewarded, and for how long a control is held."""
    problem: Problem
    """Its goal, its bounds and the contacts that it forbids."""

    @classmethod
    def find(cls, given: "str | Path | Problem | Task | Plant") -> "Plant":
        """Return the plant of a task, of a problem, or of the name or file of either.

        Args:
            given: a name that is a task's and a problem's means the task, with its reward.

        Raises:
            UsageError: it is unknown, has no goal state, or is kinematic.
        """
        if isinstance(given, Plant):
            return given
        if isinstance(given, Problem):
            return cls(task_of_problem(given), given)
        task = find_task(given)
        if not isinstance(task.problem, Problem) and (task.target_size or not task.problem):
            what = "draws a target that is not a state" if task.target_size else "has no planning problem"
            raise UsageError(
                f"task {task.name} {what}, so there is no goal to steer to: give a planning problem instead."
            )
        problem = load_problem(task.problem)
        if tuple(problem.joints) != task.joints:
            raise UsageError(f"task {task.name} and its problem {problem.name} have other joints.")
        return cls(task, problem)

    @cached_property
    def _compiled(self) -> tuple[mujoco.MjModel, StateSpace]:
        return self.problem.compile()

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self._compiled[0]

    @property
    def space(self) -> StateSpace:
        """The space of its states."""
        return self._compiled[1]

    @property
    def control_step(self) -> float:
        """Time for which a control is held [s]."""
        return self.physics_steps * float(self.model.opt.timestep)

    @property
    def physics_steps(self) -> int:
        """Physics steps for which a control is held."""
        return self.task.action_repeat * self.task.frame_skip

    def repeating(self, num: int) -> "Plant":
        """The plant with each control held for `num` steps of its task.

        Raises:
            UsageError: the number does not divide the steps of an episode.
        """
        task = repeat_actions(self.task, num)
        assert isinstance(task, Task)
        return self if task == self.task else replace(self, task=task)

    def simulator(self, num: int, threads: int = 1) -> Simulator:
        """Return simulations of the plant.

        Args:
            num: their number.
            threads: physics threads; 0 uses all CPUs.
        """
        return Simulator(self.model, self.space, num, threads=threads, validity=self.problem.validity)

    def goal(self, target: Float[np.ndarray, " target"]) -> Goal:
        """The goal region of an episode.

        Args:
            target: the goal of a task whose goals are drawn; otherwise empty.
        """
        problem, space = self.problem, self.space
        if len(target):
            weights = problem.weights_to_goal(space)
            goal = Goal(space, target, np.zeros(space.tangent_size), weights, problem.tolerance)
        else:
            goal = problem.draw_goal(space, np.random.default_rng(0))
        return at_rest(self.simulator(1), goal) if space.num_activations else goal

    def at_goal(
        self, states: Float[np.ndarray, "time state"], target: Float[np.ndarray, " target"]
    ) -> Bool[np.ndarray, " time"]:
        """Whether each state is at the goal, as the task judges it."""
        targets = np.broadcast_to(target, (len(states), len(target)))
        return np.asarray(self.task.at_goal(states, targets), dtype=bool)

    @cached_property
    def starts(self) -> Float[np.ndarray, "start state"]:
        """Some starts, always the same ones."""
        return self.task.sample_starts(NUM_STARTS, np.random.default_rng(0))[0]
