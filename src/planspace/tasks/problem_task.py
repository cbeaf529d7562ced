"""Reinforcement learning tasks from planning problems: reach the goal and stay there, for any robot."""

import re
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from planspace.errors import UsageError, quoted
from planspace.physics.angles import wrap
from planspace.physics.simulator import Simulator, control_bounds
from planspace.physics.space import StateSpace
from planspace.tasks.problem import Box, Goal, Problem
from planspace.tasks.source_hash import function_settings
from planspace.tasks.task import Task

VERSION = 1
"""Version of the functions below. It is part of a task's hash, so change it when a function returns other
numbers."""
READ = (
    *("start", "goal", "goal_random", "goal_weights", "tolerance", "velocity_bound", "position_bounds"),
    *("control_bounds", "forbidden_contacts", "predicate"),
)
"""Fields of a problem that its task depends on, besides its model and joints."""


@dataclass(frozen=True, repr=False)
class GoalTask:
    """The functions of a problem's task, as methods.

    A target is the goal of an episode, a whole state, if the problem draws goals; otherwise it is empty.
    """

    problem: Problem
    """The planning problem with its task settings."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle only the problem; the model is compiled again."""
        return GoalTask, (self.problem,)

    def hash_content(self) -> dict[str, Any]:
        """Everything that the functions depend on, as plain data for a hash."""
        own = {name: getattr(self.problem, name) for name in READ}
        own = {k: (v.low, v.high) if isinstance(v, Box) else function_settings(v) for k, v in own.items()}
        return {"version": VERSION, "task": asdict(self.problem.task), **own}

    # --- the functions of a task ------------------------------------------------------------------------

    def reward(
        self, before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        """Minus the distance to the goal after the step, minus the effort, plus the bonus at the goal."""
        settings, at_goal = self.problem.task.reward, self.at_goal(after, target)
        if settings.sparse:
            return at_goal.astype(float)
        distance = np.minimum(self._distances(after, target, self._reward_weights), settings.max_distance)
        effort = settings.effort * np.mean((control / self._largest_control) ** 2, axis=1)
        reward = settings.bonus * at_goal - distance - effort
        return np.where(self.terminated(after), reward, reward + self._alive) if self._alive else reward

    def at_goal(self, states: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " env"]:
        """Whether each state is at the goal, whatever its velocities."""
        given = self.problem.task.tolerance
        tolerance = self.problem.tolerance if given is None else given
        return np.asarray(self._distances(states, target, self._goal_weights) <= tolerance)

    def observe(self, states: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "env obs"]:
        """The state in the chosen form, and the positions of a random goal."""
        kind, angles = self.problem.task.observation, self.space.circular_columns
        parts = [states]
        if kind == "wrapped" and angles:
            parts = [states.copy()]
            parts[0][:, angles] = wrap(states[:, angles])
        elif kind == "trig":
            parts += [np.sin(states[:, angles]), np.cos(states[:, angles])]
        if self.problem.goal_random:
            parts.append(target[:, : self.space.num_positions])
        return np.concatenate(parts, axis=1)

    def terminated(self, states: np.ndarray) -> Bool[np.ndarray, " env"]:
        """Whether each state ends its episode."""
        ends = self.problem.task.termination
        ended = np.zeros(len(states), dtype=bool)
        if ends.bounds or ends.contacts:
            ended |= ~self._checker(len(states)).valid_states(states)
        for name, level in ends.below:
            ended |= states[:, self.space.names.index(name)] < level
        return ended

    def draw_targets(self, num: int, rng: np.random.Generator) -> Float[np.ndarray, "env state"]:
        """Draw valid goals from the problem's box."""
        simulator = self._state_checker
        goals = [self.problem.draw_goal(self.space, rng, simulator).center for _ in range(num)]
        return np.array(goals).reshape(num, self.space.size)

    def draw_starts(self, num: int, rng: np.random.Generator) -> Float[np.ndarray, "env state"]:
        """Draw valid starts from the problem's box, as plans do."""
        simulator = self._state_checker
        starts = [self.problem.draw_start(simulator, rng) for _ in range(num)]
        return np.array(starts).reshape(num, self.space.size)

    @property
    def obs_fields(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each number of an observation."""
        names, units = self.space.names, self.space.units
        found = list(zip(names, units, strict=True))
        if self.problem.task.observation == "trig":
            angles = [names[column] for column in self.space.circular_columns]
            found += [(f"{function}_{angle}", "") for function in ("sin", "cos") for angle in angles]
        if self.problem.goal_random:
            found += [(f"goal_{name}", unit) for name, unit in found[: self.space.num_positions]]
        return tuple(found)

    # --- what they are computed from --------------------------------------------------------------------

    @cached_property
    def _compiled(self) -> tuple[mujoco.MjModel, StateSpace]:
        return self.problem.compile()

    @property
    def space(self) -> StateSpace:
        """The problem's state space."""
        return self._compiled[1]

    @property
    def timestep(self) -> float:
        """Physics step [s]."""
        return float(self._compiled[0].opt.timestep)

    def _distances(
        self, states: np.ndarray, target: np.ndarray, weights: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        """Weighted distance of each state from the goal, or from the nearest state of a fixed goal's box."""
        if self.problem.goal_random:
            outside = np.abs(self.space.difference(states, target))
        else:
            outside = np.abs(self.space.difference(states, self._goal.center)) - self._goal.half
        return np.sum(np.maximum(outside, 0.0) * weights, axis=1)

    @cached_property
    def _goal(self) -> Goal:
        return self.problem.draw_goal(self.space, np.random.default_rng(0))

    @cached_property
    def _goal_weights(self) -> Float[np.ndarray, " tangent"]:
        """The problem's weights of positions, or all of its weights if those are 0."""
        weights = self.problem.weights_to_goal(self.space)
        positions = np.where(np.arange(len(weights)) < self.space.num_dofs, weights, 0.0)
        return positions if positions.any() else weights

    @cached_property
    def _reward_weights(self) -> Float[np.ndarray, " tangent"]:
        given = self.problem.task.reward.distance
        if not given:  # the mean, so that a robot of many joints is not beyond `max_distance` everywhere
            return self._goal_weights / max(1, np.count_nonzero(self._goal_weights))
        return np.array([*given, *(0.0,) * (self.space.tangent_size - len(given))])

    @cached_property
    def _largest_control(self) -> Float[np.ndarray, " control"]:
        low, high = control_bounds(*self._compiled)
        return np.maximum(np.abs(low), np.abs(high))

    @cached_property
    def _alive(self) -> float:
        settings = self.problem.task
        if settings.reward.alive is not None:
            return settings.reward.alive
        return settings.reward.max_distance if settings.termination.possible else 0.0

    @cached_property
    def _state_checker(self) -> Simulator:
        model, space = self._compiled
        return Simulator(model, space, 1, threads=1, validity=self.problem.validity)

    def _checker(self, num: int) -> Simulator:
        """A simulator that says which states do not end an episode; it is kept for the next call."""
        kept = self.__dict__.get("_kept")
        if kept is None or kept.num < num:
            model, space = self._compiled
            ends, validity = self.problem.task.termination, replace(self.problem.validity, predicate=None)
            validity = validity if ends.contacts else replace(validity, forbidden_contacts="none")
            kept = Simulator(model, _given_bounds(model, space, ends.bounds), num, validity=validity)
            self.__dict__["_kept"] = kept
        return kept


def _given_bounds(model: mujoco.MjModel, space: StateSpace, kept: bool) -> StateSpace:
    """The space with only the bounds that the model does not have, or with none."""
    own = StateSpace.from_model(model, space.joints)
    given = kept & ~(np.isfinite(own.low) | np.isfinite(own.high))
    return replace(
        space,
        low=np.where(given, space.low, -np.inf),
        high=np.where(given, space.high, np.inf),
        ball_range=(np.inf,) * len(space.ball_range),
        velocity_bound=np.full_like(space.velocity_bound, np.inf),
    )


def task_of_problem(problem: Problem) -> Task:
    """Return the task that a problem describes: reach its goal from its starts, and stay there.

    Args:
        problem: the problem; its field `task` has the settings that planning does not need.

    Raises:
        UsageError: the problem is kinematic, or its settings do not fit it.
        PlanspaceError: its model does not compile.
    """
    if problem.kinematic:
        raise UsageError(
            f"problem {quoted(problem.name)} is kinematic: nothing has mass, so there is nothing to train. "
            "Leave out kinematic."
        )
    functions, settings = GoalTask(problem), problem.task
    _check_termination(problem)
    start = problem.box("start", functions.space)
    return Task(
        name=re.sub(r"[^\w.-]", "-", problem.name) or "task",
        model=problem.source,
        joints=problem.joints,
        start_low=start.low,
        start_high=start.high,
        horizon=settings.horizon(functions.timestep),
        frame_skip=settings.frame_skip(functions.timestep),
        reward=functions.reward,
        at_goal=functions.at_goal,
        observe=functions.observe,
        obs_fields=functions.obs_fields,
        trig_columns=() if settings.observation == "trig" else None,
        terminated=functions.terminated,
        draw_starts=functions.draw_starts,
        draw_targets=functions.draw_targets if problem.goal_random else None,
        problem=problem,
    )


def _check_termination(problem: Problem) -> None:
    ends = problem.task.termination
    if ends.bounds and not problem.position_bounds:
        raise UsageError(
            f"problem {quoted(problem.name)}: task: termination: bounds needs position_bounds; the model "
            "itself limits its other joints."
        )
    if ends.contacts and problem.forbidden_contacts == "none":
        raise UsageError(
            f"problem {quoted(problem.name)}: task: termination: contacts needs forbidden_contacts."
        )
