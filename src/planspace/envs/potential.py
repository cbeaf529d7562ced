"""The potential of states: minus the distance in z to the goal, for reward shaping."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from planspace.embed.embedding import Embedding, norm
from planspace.envs.columns import Column
from planspace.envs.goal_states import DESIRED, Goal, GoalStates
from planspace.envs.input_check import InputCheck
from planspace.envs.source import StateSource
from planspace.errors import UsageError

RELABELLING = "shaping_z"
"""Entry of a step's info: z before and after the step [2, z]; the second is NaN if the episode terminated."""


@dataclass(frozen=True)
class Potential:
    """Computes the potential of each state from (observation, info)."""

    embedding: Embedding
    source: StateSource
    check: InputCheck
    goal: np.ndarray | GoalStates
    """The goal as a state, or what reads it from observations."""
    scale: float

    def __call__(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        """Return the potentials, with the leading axes of the observation."""
        return self.of(self.encode(obs, info), obs, info)

    def encode(self, obs: Any, info: dict[str, Any]) -> np.ndarray:
        """Compute z of the states."""
        return self.embedding.encode(self.check(self.source(obs, info)))

    def of(self, z: np.ndarray, obs: Any, info: dict[str, Any]) -> np.ndarray:
        """Return the potentials of states whose z is known."""
        goal = self.goal if isinstance(self.goal, np.ndarray) else self.goal(obs, info)
        return np.asarray(-self.scale * norm(z - self.embedding.encode(goal)), dtype=float)

    @property
    def is_relabelled(self) -> bool:
        """Whether the goal depends on `desired_goal`, which HER replaces."""
        return isinstance(self.goal, GoalStates) and DESIRED in self.goal.keys

    def relabelled_shaping(
        self, infos: Sequence[Mapping[str, Any]], desired_goals: np.ndarray, discount: float
    ) -> np.ndarray:
        """Compute the shaping of steps for other goals.

        Args:
            infos: the info of each step.
            desired_goals: the goal to assume in each step [step, goal].
            discount: the discount of the agent.

        Raises:
            UsageError: an info is not that of a step, or the goal is also read from other entries.
        """
        key = RELABELLING if self.is_relabelled else "shaping"
        if missing := [info for info in infos if key not in info]:
            found = ", ".join(map(repr, missing[0])) or "no entries"
            raise UsageError(
                f"the shaping of a relabelled step needs info[{key!r}], which `step` returns, got an info "
                f"with {found}: use planspace.envs.her.PlanSpaceHerReplayBuffer, or HerReplayBuffer with "
                "copy_info_dict=True."
            )
        recorded = np.stack([info[key] for info in infos])
        if not isinstance(self.goal, GoalStates) or not self.is_relabelled:
            return recorded
        if others := self.goal.keys - {DESIRED}:
            raise UsageError(
                f"the goal is read from desired_goal and from {', '.join(sorted(others))}, so that it is not "
                "known for a relabelled step: give numbers, or places in desired_goal only."
            )
        z_goal = self.embedding.encode(self.goal({DESIRED: desired_goals}, {}))
        before, after = (-self.scale * norm(recorded[:, i] - z_goal) for i in range(2))
        return discount * np.nan_to_num(after) - before


def find_goal(goal: Goal | None, goal_columns: Sequence[Column] | None) -> Goal:
    """Return the goal from the two arguments of a shaping wrapper that can give it.

    Raises:
        UsageError: both are given, or neither.
    """
    if (goal is None) == (goal_columns is None):
        raise UsageError("give either the goal, or goal_columns, the columns of the goal in the observation.")
    return [str(column) for column in goal_columns] if goal_columns is not None else goal or ()


def check_scale(scale: float) -> float:
    """Return the scale.

    Raises:
        UsageError: it is not a number above 0.
    """
    if not (isinstance(scale, Real) and np.isfinite(scale) and scale > 0):
        raise UsageError(f"scale must be a number above 0, got {scale!r}.")
    return scale
