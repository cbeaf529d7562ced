"""What a policy observes if z and the state are read from pictures."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import Embedding
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.embed.pixels.sight import Sight
from planspace.errors import UsageError
from planspace.plan.state_filter import StateFilter
from planspace.rl.saved_policy import Policy
from planspace.tasks.gymnasium import AnyTask
from planspace.tasks.task import Task


class PixelObservations:
    """The observations of a policy that was trained on states, computed from pictures.

    Where the policy observes the state, it gets the encoder's estimate of it. If the errors of the estimates
    are known, a filter joins them, and z is that of the filtered state in the policy's own embedding;
    otherwise z is the encoder's. The target of a task with targets is not read from pictures.
    """

    def __init__(self, policy: Policy, task: AnyTask, encoder: ImageEncoder):
        """Check that policy and encoder fit together, and open the renderer.

        Raises:
            UsageError: the task is not one of planspace, or the policy's z is another one than the encoder's
                and nothing filters the states.
            PlanspaceError: no OpenGL backend works here.
        """
        if not isinstance(task, Task):
            raise UsageError(f"pictures are drawn of planspace's own tasks, {task.name} is none.")
        about = policy.about
        if about.get("goal", "raw") == "z":
            raise UsageError("the policy observes z of its goal, which is not read from pictures.")
        own = policy.load_embedding() if about["z"] != "none" else None
        if own is not None and _same_z(own, encoder.teacher):
            own = None  # the encoder's z is the policy's
        if own is not None and encoder.state_error is None:
            raise UsageError(
                "the policy was trained with another embedding than the teacher of the encoder, which does "
                f"not know the errors of its states: train an encoder with --teacher {policy.embedding}."
            )
        model, space = task.compile()
        self._own, self._columns = own, [] if own is None else list(own.columns_of(space.names))
        num_steps = task.action_repeat * task.frame_skip
        self._motion = model, space, num_steps
        self._sight = Sight(encoder, model, space, num_steps * float(model.opt.timestep))
        self._task, self._about = task, about

    def restart(self, seed: int) -> None:
        """Begin an episode."""
        error = self._sight.state_error
        state_filter = None if error is None else StateFilter(*self._motion, error)
        self._sight.restart(np.random.default_rng((seed, 1)), state_filter)

    def applied(self, action: Float[np.ndarray, " action"]) -> None:
        """Take note of the action that is applied."""
        self._sight.applied(action.astype(float))

    def __call__(self, state: Float[np.ndarray, " state"], env: Any) -> Float[np.ndarray, " obs"]:
        """Draw the present state, and return what the policy observes.

        Args:
            state: the present state, which is only drawn.
            env: the environment, which knows the target.
        """
        z, seen = self._sight.see(state)
        if self._own is not None:
            z = self._own.encode(seen[self._columns])
        about, parts = self._about, []
        if about["z"] != "replace" or about["z_to"] != "both":
            parts.append(self._task.observe_as(about["obs"], seen[None], env.target[None])[0])
        if about["z"] != "none":
            parts.append(z)
        return np.concatenate(parts).astype(np.float32)


def _same_z(a: Embedding, b: Embedding) -> bool:
    """Whether two embeddings compute the same z; one of them may also estimate times."""
    return replace(a, time_head=None).hash == replace(b, time_head=None).hash
