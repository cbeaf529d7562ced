"""A goal-conditioned agent of Stable-Baselines3 that observes z of its goals: SAC with HER on the cart-pole.

    pip install '.[sb3]'
    python examples/her_goals.py EMBEDDING --steps 50000

EMBEDDING is a folder written by `planspace embed` or `planspace run`. The cart is to reach a random position
with the pole up. HER relabels the goal of each step with a position that the cart reached later. z of the
goal and the shaping are computed for the new goal.
"""

import argparse
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from stable_baselines3 import SAC

import planspace as ps
from planspace.envs.her import PlanSpaceHerReplayBuffer
from planspace.envs.wrappers import PlanSpaceShaping

GOAL = {"slider": "desired_goal[0]", "hinge": 0.0, "slidervel": 0.0, "hingevel": 0.0}
STATE = [f"observation[{i}]" for i in range(4)]


class CartGoals(gymnasium.Wrapper):
    """The cart-pole as a goal environment: the goal is a position of the cart."""

    def __init__(self, env: gymnasium.Env):
        super().__init__(env)
        goal = Box(-np.inf, np.inf, (1,), np.float32)
        self.observation_space = Dict(
            {"observation": env.observation_space, "achieved_goal": goal, "desired_goal": goal}
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Start an episode with a new goal."""
        obs, info = self.env.reset(seed=seed, options=options)
        self.goal = self.np_random.uniform(-0.5, 0.5, 1).astype(np.float32)
        return self._observe(obs), info

    def step(self, action: np.ndarray):
        """Take a step; it earns 0 near the goal and -1 elsewhere."""
        obs, _, terminated, truncated, info = self.env.step(action)
        reward = float(self.compute_reward(obs[:1], self.goal, info))
        return self._observe(obs), reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> np.ndarray:
        """Compute the reward of a step, or of a batch of steps."""
        return -(np.abs(achieved_goal - desired_goal)[..., 0] > 0.05).astype(np.float32)

    def _observe(self, obs: np.ndarray) -> dict[str, np.ndarray]:
        return {"observation": obs, "achieved_goal": obs[:1], "desired_goal": self.goal}


def make_env(embedding: str) -> gymnasium.Env:
    """Make the environment with shaping by the distance in z to the goal, and with z of state and goals."""
    env = CartGoals(gymnasium.make("planspace/CartPole-v0"))
    return ps.wrap(PlanSpaceShaping(env, embedding, GOAL, columns=STATE), embedding, columns=STATE, goal=GOAL)


def main() -> None:
    """Train an agent and print how often it reaches its goals."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("embedding", metavar="EMBEDDING")
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--episodes", type=int, default=20)
    arguments = parser.parse_args()
    env = make_env(arguments.embedding)
    agent = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=PlanSpaceHerReplayBuffer,
        learning_starts=200,
        seed=0,
        device="cpu",
    )
    agent.learn(arguments.steps)
    reached = 0
    for episode in range(arguments.episodes):
        obs, _ = env.reset(seed=episode)
        ended = False
        while not ended:
            obs, _, terminated, truncated, _ = env.step(agent.predict(obs, deterministic=True)[0])
            ended = terminated or truncated
        reached += bool(not terminated and np.abs(obs["achieved_goal"] - obs["desired_goal"])[0] <= 0.05)
    print(f"observes {', '.join(env.observation_space)}; reached {reached} of {arguments.episodes} goals")


if __name__ == "__main__":
    main()
