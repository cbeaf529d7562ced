"""The reward `progress`: the time to go to the goal that a step saves."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import Embedding
from planspace.errors import UsageError
from planspace.rl.config import TrainConfig
from planspace.rl.task_goal import GoalStates, goal_states
from planspace.tasks.gymnasium import AnyTask


@dataclass(frozen=True)
class Progress:
    """What a step is paid for progress: the decrease of `Embedding.time_to_go`, in seconds."""

    goals: GoalStates
    embeddings: tuple[Embedding, ...]
    """One for all seeds, or one for each; each has a time head."""
    columns: tuple[list[int], ...]
    """The columns of the task's state that each embedding reads."""
    num_seeds: int
    """Seeds, whose environments follow one another; the reward of a seed does not depend on the others."""

    @classmethod
    def of(cls, config: TrainConfig, task: AnyTask, embeddings: tuple[Embedding, ...]) -> "Progress | None":
        """The reward of an arm; None if its reward is another one.

        Args:
            config: the settings.
            task: the task.
            embeddings: one for all seeds, or one for each.

        Raises:
            UsageError: the task has no goal state, or there is no embedding, or it has no time head.
        """
        if config.reward != "progress":
            return None
        goals = goal_states(task, "--reward progress")
        if not embeddings or any(embedding.time_head is None for embedding in embeddings):
            raise UsageError(
                "--reward progress needs an embedding with a time head: train it with `planspace embed "
                "--time-head` and give --embedding DIR."
            )
        fields = task.state_names, task.state_units
        columns = tuple(list(embedding.columns_of(*fields)) for embedding in embeddings)
        return cls(goals, embeddings, columns, config.num_seeds)

    def __call__(
        self,
        before: Float[np.ndarray, "env state"],
        after: Float[np.ndarray, "env state"],
        targets: Float[np.ndarray, "env target"],
    ) -> Float[np.ndarray, " env"]:
        """Seconds by which a step comes nearer to the goal of its episode; negative if it moves away.

        Args:
            before: the states before the step, the environments of a seed one after another.
            after: the states after it.
            targets: the targets of the episodes.
        """
        states = np.stack([before, after, self.goals(targets)])
        by_seed = states.reshape(3, self.num_seeds, -1, states.shape[-1])
        groups = [by_seed] if len(self.embeddings) == 1 else list(by_seed.swapaxes(0, 1)[:, :, None])
        parts = []
        for embedding, columns, group in zip(self.embeddings, self.columns, groups, strict=True):
            start, end, goal = group[..., columns]
            saved = embedding.time_to_go(start, goal) - embedding.time_to_go(end, goal)
            parts.append(np.asarray(saved, float).ravel())
        return np.concatenate(parts)
