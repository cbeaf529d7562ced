"""A small goal environment, and embeddings of its states."""

from typing import Any

import gymnasium
import jax.random as jr
import numpy as np
from gymnasium.spaces import Box, Dict

from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.embed.networks import GaussianNetwork
from planspace.embed.support import Support

NAMES = ("x", "y", "vx", "vy")
COLUMNS = [f"observation[{i}]" for i in range(4)]
GOAL = {"x": "desired_goal[0]", "y": "desired_goal[1]", "vx": 0.0, "vy": 0.0}
REACHED = 0.3


class PointEnv(gymnasium.Env):
    """A point mass in a square of the plane; it earns 0 at its goal and -1 elsewhere."""

    observation_space = Dict(
        {
            "observation": Box(-np.inf, np.inf, (4,), np.float64),
            "achieved_goal": Box(-np.inf, np.inf, (2,), np.float64),
            "desired_goal": Box(-np.inf, np.inf, (2,), np.float64),
        }
    )
    action_space = Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.state = np.append(self.np_random.uniform(-1, 1, 2), [0.0, 0.0])
        self.goal = self.np_random.uniform(-1, 1, 2)
        return self.observe(), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.state[2:] += 0.3 * np.asarray(action)
        self.state[:2] += 0.3 * self.state[2:]
        obs = self.observe()
        reward = float(self.compute_reward(obs["achieved_goal"], self.goal, {}))
        return obs, reward, bool(np.abs(self.state[:2]).max() > 2), False, {}

    def observe(self) -> dict[str, np.ndarray]:
        return {
            "observation": self.state.copy(),
            "achieved_goal": self.state[:2].copy(),
            "desired_goal": self.goal.copy(),
        }

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        return -(np.linalg.norm(achieved_goal - desired_goal, axis=-1) > REACHED).astype(float)


def point_env(steps: int = 10) -> gymnasium.Env:
    return gymnasium.wrappers.TimeLimit(PointEnv(), steps)


def point_embedding(seed: int = 0, names: tuple[str, ...] = NAMES) -> Embedding:
    """An embedding with random weights; its demonstrations are states within one standard deviation of 2."""
    num = len(names)
    inputs = Inputs(names, ("",) * num, (), "standard", np.zeros(num), np.full(num, 2.0))
    net = GaussianNetwork(num, 3, (16,), 0.0, key=jr.key(seed))
    weights, biases = [np.asarray(w) for w in net.weights], [np.asarray(b) for b in net.biases]
    decoder = ([np.zeros((2 * num, 3))], [np.zeros(2 * num)])
    drawn = np.random.default_rng(0).normal(size=(2, 500, num))
    support = Support.fit(drawn[0], drawn[1], np.random.default_rng(1))
    return Embedding(inputs, (weights, biases), decoder, 0.2, support=support)
