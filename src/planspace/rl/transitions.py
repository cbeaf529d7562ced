"""Steps of a task that do not come from a policy."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


class Transitions(NamedTuple):
    """Steps of a task, one in each row, for an algorithm with a replay buffer."""

    obs: Float[np.ndarray, "row obs"]
    """Observations before the step, as in `Rollout`; float32."""
    actions: Float[np.ndarray, "row action"]
    """Actions within the limits of the controls; float32."""
    rewards: Float[np.ndarray, " row"]
    """Rewards of the task, of the run's reward type."""
    next_obs: Float[np.ndarray, "row obs"]
    """Observations after the step; float32."""
    terminated: Bool[np.ndarray, " row"]
    """Whether the episode ends there. No step reaches the time limit."""
