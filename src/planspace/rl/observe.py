"""Observations: the task's own with or without z, and the columns that policy and critic read.

With `goal` set to `z`, z is followed by z of the goal, the unit vector from z to it, and their distance.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import Embedding, norm
from planspace.errors import UsageError
from planspace.rl.config import GoalMode, ZMode, ZTarget
from planspace.rl.task_goal import GoalStates, goal_states
from planspace.tasks.gymnasium import AnyTask
from planspace.tasks.observation_types import ObservationType

LEAST_DISTANCE = 1e-9
"""Differences of z are divided by at least this, so that the direction at the goal is 0."""


@dataclass(frozen=True)
class Observer:
    """Turns states and targets into observations, and tells which columns policy and critic read."""

    task: AnyTask
    obs: ObservationType
    z: ZMode
    z_to: ZTarget
    embeddings: tuple[Embedding, ...] = ()
    """The embeddings that compute z: one for all seeds, or one per seed."""
    num_seeds: int = 1
    """Number of seeds, whose environments follow one another, the same number for each seed. The observations
    of a seed do not depend on the others, bit for bit."""
    goal: GoalMode = "raw"
    """Whether z of the goal is observed, too."""

    def __post_init__(self) -> None:
        """Check that task and embeddings fit.

        Raises:
            UsageError: z is observed but there is no embedding, an embedding reads other states, or
                embeddings differ in the size of z; or z of the goal is observed, but the goal is no state.
        """
        if self.z == "none":
            return
        if not self.embeddings:
            raise UsageError(f"z is {self.z!r}, which needs an embedding: give --embedding DIR.")
        if len({embedding.z_dim for embedding in self.embeddings}) > 1:
            sizes = ", ".join(str(embedding.z_dim) for embedding in self.embeddings)
            raise UsageError(f"embeddings of one run must have the same number of z, got {sizes}.")
        _ = self._embedded_columns
        if self.goal == "z":
            _ = self._goals

    def __call__(
        self, states: Float[np.ndarray, "env state"], targets: Float[np.ndarray, "env target"]
    ) -> Float[np.ndarray, "env obs"]:
        """Observations, as float32."""
        parts = []
        if self.z != "replace" or self.z_to != "both":
            parts.append(self.task.observe_as(self.obs, states, targets))
        if self.z != "none":
            parts += self._z_parts(states, targets)
        return np.concatenate(parts, axis=1).astype(np.float32)

    @property
    def policy_columns(self) -> slice:
        """The columns that the policy reads."""
        return self._columns("policy")

    @property
    def critic_columns(self) -> slice:
        """The columns that the critic reads."""
        return self._columns("critic")

    def _z_parts(self, states: np.ndarray, targets: np.ndarray) -> list[np.ndarray]:
        z = self._encoded(states)
        if self.goal == "raw":
            return [z]
        z_goal = self._encoded(self._goals(targets))
        distance = norm(z_goal - z)[:, None]
        return [z, z_goal, (z_goal - z) / np.maximum(distance, LEAST_DISTANCE), distance]

    def _encoded(self, states: Float[np.ndarray, "row state"]) -> Float[np.ndarray, "row z"]:
        states = states.reshape(self.num_seeds, -1, states.shape[-1])
        groups = [states] if len(self.embeddings) == 1 else list(states[:, None])
        parts = zip(self.embeddings, self._embedded_columns, groups, strict=True)
        z = np.concatenate([e.encode(group[..., columns]) for e, columns, group in parts])
        return z.reshape(-1, z.shape[-1])

    @cached_property
    def num_obs(self) -> int:
        """Numbers in an observation, including z."""
        own = 0 if self.z == "replace" and self.z_to == "both" else self._num_own
        return own + (self._num_z if self.z != "none" else 0)

    @property
    def num_policy_obs(self) -> int:
        """Numbers that the policy reads."""
        return len(range(self.num_obs)[self.policy_columns])

    @property
    def num_critic_obs(self) -> int:
        """Numbers that the critic reads."""
        return len(range(self.num_obs)[self.critic_columns])

    @property
    def _num_z(self) -> int:
        size = self.embeddings[0].z_dim
        return size if self.goal == "raw" else 3 * size + 1

    @cached_property
    def _goals(self) -> GoalStates:
        return goal_states(self.task, "--goal z")

    @property
    def _num_own(self) -> int:
        return len(self.task.fields(self.obs))

    @cached_property
    def _embedded_columns(self) -> list[list[int]]:
        """The columns of the task's state that each embedding reads."""
        names, units = self.task.state_names, self.task.state_units
        try:
            return [list(embedding.columns_of(names, units)) for embedding in self.embeddings]
        except UsageError as error:
            raise UsageError(f"task {self.task.name}: {error}") from None

    def _columns(self, reader: str) -> slice:
        if self.z == "none" or self.z_to == "both":
            return slice(None)
        own = self._num_own
        if reader != self.z_to:
            return slice(0, own)
        return slice(own, None) if self.z == "replace" else slice(None)
