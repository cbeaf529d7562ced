"""What an agent sees: the task's observation, sin and cos if asked for, and z; and which part sees which."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import Embedding
from planspace.errors import UsageError
from planspace.forms import ObsForm
from planspace.rl.config import ZMode, ZTarget
from planspace.tasks import Task


@dataclass(frozen=True)
class Observer:
    """States and targets to observations, and the columns of them that policy and critic read."""

    task: Task
    obs: ObsForm
    z: ZMode
    z_to: ZTarget
    embedding: Embedding | None

    def __post_init__(self) -> None:
        """Checks that the parts fit.

        Raises:
            UsageError: an arm with z has no embedding, or one for other states.
        """
        if self.z == "none":
            return
        if self.embedding is None:
            raise UsageError(f"z is {self.z!r}, which needs an embedding: give --embedding DIR.")
        _ = self._embedded_columns

    def __call__(
        self, states: Float[np.ndarray, "env state"], targets: Float[np.ndarray, "env target"]
    ) -> Float[np.ndarray, "env obs"]:
        """The observations, float32."""
        parts = []
        if self.z != "replace" or self.z_to != "both":
            parts.append(self.task.observe_as(self.obs, states, targets))
        if self.embedding is not None and self.z != "none":
            parts.append(self.embedding.encode(states[:, self._embedded_columns]))
        return np.concatenate(parts, axis=1).astype(np.float32)

    @property
    def policy_columns(self) -> slice:
        """The columns the policy reads."""
        return self._columns("policy")

    @property
    def critic_columns(self) -> slice:
        """The columns the critic reads."""
        return self._columns("critic")

    @cached_property
    def _embedded_columns(self) -> list[int]:
        """Where in the task's state the embedding's states are."""
        assert self.embedding is not None
        _, space = self.task.compile()
        try:
            return list(self.embedding.columns_of(space.names))
        except UsageError as error:
            raise UsageError(f"task {self.task.name}: {error}") from None

    def _columns(self, reader: str) -> slice:
        if self.z == "none" or self.z_to == "both":
            return slice(None)
        own = len(self.task.fields(self.obs))
        if reader != self.z_to:
            return slice(0, own)
        return slice(own, None) if self.z == "replace" else slice(None)
