"""Small Gymnasium environments: importing this module registers them."""

import os
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete


class Puck(gymnasium.Env):
    """A puck on a rail: observe position and velocity, push it to 0. It stops by itself beyond 3."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, render_mode: str | None = None, push: float = 1.0, broken: str = ""):
        self.render_mode, self.push, self.broken = render_mode, push, broken
        self.observation_space = Dict({"puck": Box(-np.inf, np.inf, (2,)), "last": Box(-1, 1, (1, 1))})
        self.action_space = Box(-1, 1, (1, 1))

    def observe(self, last: float) -> dict[str, np.ndarray]:
        puck = np.array([self.x, self.v], np.float32)
        return {"puck": puck, "last": np.full((1, 1), last, np.float32)}

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict, dict]:
        super().reset(seed=seed)
        self.x, self.v = self.np_random.uniform(-1, 1, 2)
        return self.observe(0.0), {}

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        assert action.shape == (1, 1) and action.dtype == np.float32 and np.abs(action).max() <= 1
        if self.broken == "error" and abs(self.x) > 0.5:
            raise RuntimeError("the rail\nbroke")
        self.v += 0.1 * self.push * float(action[0, 0])
        self.x += 0.1 * self.v
        if self.broken == "exit":
            os._exit(7)
        if self.broken == "nan" and abs(self.x) > 0.5:
            self.x = np.nan
        reward = float("inf") if self.broken == "reward" else -abs(self.x)
        return self.observe(float(action[0, 0])), reward, abs(self.x) > 3, False, {}

    def render(self) -> np.ndarray:
        return np.full((33, 41, 3), int(np.clip(80 * abs(self.x), 0, 255)), np.uint8)


class Blind(Puck):
    """A puck that cannot be drawn."""

    metadata = {"render_modes": []}  # noqa: RUF012


class Chooser(Puck):
    """A puck with two choices instead of a force."""

    def __init__(self, render_mode: str | None = None):
        super().__init__(render_mode)
        self.action_space = Discrete(2)


class Reader(Puck):
    """A puck that observes a choice."""

    def __init__(self, render_mode: str | None = None):
        super().__init__(render_mode)
        self.observation_space = Dict({"choice": Discrete(2)})


for name, kind, limit in (
    ("Puck", Puck, 20),
    ("Blind", Blind, 20),
    ("Endless", Puck, None),
    ("Chooser", Chooser, 20),
    ("Reader", Reader, 20),
):
    if f"tiny/{name}-v0" not in gymnasium.registry:
        gymnasium.register(f"tiny/{name}-v0", kind, max_episode_steps=limit)
