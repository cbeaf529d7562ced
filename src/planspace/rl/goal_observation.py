"""The observation of an agent that sees z of its goal, in a single environment."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from planspace.rl.observe import Observer


class GoalObservation(gymnasium.ObservationWrapper[Any, Any, Any]):
    """Show what an `Observer` shows in training; for environments of planspace's own tasks."""

    def __init__(self, env: gymnasium.Env[Any, Any], observer: Observer):
        """Wrap an environment.

        Args:
            env: the environment, which has the attributes `state` and `target`.
            observer: what the agent observes.
        """
        super().__init__(env)
        self._observer = observer
        self.observation_space = Box(-np.inf, np.inf, (observer.num_obs,), np.float32)

    def observation(self, observation: Any) -> np.ndarray:
        """Return what the agent observes at the present state."""
        inner: Any = self.env.unwrapped
        return self._observer(inner.state[None], inner.target[None])[0]
