"""Probe environments: tasks so small that the right value and action are known.

They use the physics of the cart-pole, whose states only serve as observations.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from planspace.envs.episodes import TaskEpisodes
from planspace.rl import training
from planspace.rl.algorithms import find_algorithm
from planspace.rl.arm import Arm
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.policy_network import Actor
from planspace.rl.training import num_episodes
from planspace.tasks.catalog import TASKS
from planspace.tasks.task import Task, never

ARMS = [
    ("trpo", "paper"),
    pytest.param("trpo", "modern", marks=pytest.mark.nightly),
    pytest.param("ppo", "paper", marks=pytest.mark.nightly),
    ("ppo", "modern"),
]
LONG_ARMS = [pytest.param("trpo", "paper", marks=pytest.mark.slow), *ARMS[1:]]
"""For tests with many iterations of TRPO."""
GAMMA = 0.99


ENOUGH = {"trpo": 60, "ppo": 15}
"""Iterations. PPO takes larger steps; once the standard deviation of its actions is almost 0, a step can be
too large."""
STEPS = 1000
"""Steps per iteration and seed."""


def probe(reward, horizon: int = 1) -> Task:
    """A task with this reward (before, after, control) and horizon, in which every step terminates."""
    return replace(
        TASKS["cartpole"],
        horizon=horizon,
        start_low=(-1.0, -1.0, 0.0, 0.0),
        start_high=(1.0, 1.0, 0.0, 0.0),
        reward=lambda before, after, control, target: reward(before, after, control),
        terminated=lambda after: np.ones(len(after), bool),
    )


class Trained:
    """The result of some iterations of training."""

    def __init__(self, task: Task, algo: str, preset: str, iterations: int = 20):
        algorithm = find_algorithm(algo, preset)
        config = TrainConfig(algorithm, num_seeds=2, steps=iterations * STEPS, batch_steps=STEPS)
        observer = Observer(task, "raw", "none", "both")
        arm = Arm(config, observer, TaskEpisodes(task, 2 * num_episodes(task, STEPS)))
        with ThreadPoolExecutor(2) as threads:
            run = training._Training(arm, threads)
            state = training._init(run)
            for i in range(iterations):
                state = training._iterate(run, state, i)
            self.agents, self.networks = state.agents, training._networks(run, state)

    def value(self, obs: np.ndarray, step: int = 0) -> np.ndarray:
        """The value of one observation, for each seed."""
        row = obs[None].astype(np.float32)
        rows = [row if n.statistics is None else n.statistics(row) for n in self.networks]
        values = [a.critic.values(x, np.array([step])) for a, x in zip(self.agents, rows, strict=True)]
        return np.concatenate(values)

    def action(self, obs: np.ndarray) -> np.ndarray:
        """The mean action, for each seed."""
        both = np.broadcast_to(obs.astype(np.float32), (2, 1, 4))
        return Actor(self.networks)(both, np.zeros((2, 1, 1)))[:, 0, 0]


@pytest.mark.parametrize(("algo", "preset"), ARMS)
def test_the_value_of_one_step_is_its_reward(algo: str, preset: str) -> None:
    trained = Trained(probe(lambda before, after, control: np.full(len(before), 0.7)), algo, preset, 10)
    np.testing.assert_allclose(trained.value(np.array([0.5, -0.5, 0, 0])), 0.7, atol=0.02)


@pytest.mark.parametrize(("algo", "preset"), ARMS)
def test_a_later_reward_is_discounted(algo: str, preset: str) -> None:
    # the cart rolls at 5 m/s with any action, past 0.1 m in the first step and 0.3 m in the second
    task = replace(
        probe(lambda before, after, control: (before[:, 0] > 0.1).astype(float), horizon=2),
        start_low=(0.0, 0.0, 5.0, 0.0),
        start_high=(0.0, 0.0, 5.0, 0.0),
        terminated=lambda x: x[:, 0] > 0.3,
    )
    trained = Trained(task, algo, preset, 30)
    first, second = np.array([0.0, 0.0, 5.0, 0.0]), np.array([0.2, 0.0, 5.0, 0.0])
    np.testing.assert_allclose(trained.value(first, 0), GAMMA, atol=0.03)
    np.testing.assert_allclose(trained.value(second, 1), 1.0, atol=0.03)


@pytest.mark.nightly  # the next test asks for more
@pytest.mark.parametrize(("algo", "preset"), LONG_ARMS)
def test_the_better_action_is_found(algo: str, preset: str) -> None:
    task = probe(lambda before, after, control: -((control[:, 0] - 1.0) ** 2))
    trained = Trained(task, algo, preset, ENOUGH[algo])
    np.testing.assert_allclose(trained.action(np.zeros(4)), 1.0, atol=0.2)


@pytest.mark.parametrize(("algo", "preset"), LONG_ARMS)
def test_the_better_action_depends_on_the_observation(algo: str, preset: str) -> None:
    task = probe(lambda before, after, control: -((control[:, 0] - np.sign(before[:, 0])) ** 2))
    trained = Trained(task, algo, preset, ENOUGH[algo])
    assert (trained.action(np.array([0.7, 0.0, 0.0, 0.0])) > 0.6).all()
    assert (trained.action(np.array([-0.7, 0.0, 0.0, 0.0])) < -0.6).all()


@pytest.mark.parametrize(("algo", "preset"), ARMS)
def test_rewards_beyond_the_time_limit_count_only_with_modern(algo: str, preset: str) -> None:
    """The reward is 1 in every step, so the value without a time limit is 1 / (1 - gamma) = 100."""
    task = replace(probe(lambda before, after, control: np.ones(len(before)), horizon=10), terminated=never)
    value = Trained(task, algo, preset, 12).value(np.zeros(4), 0)
    ten_steps = (1 - GAMMA**10) / (1 - GAMMA)  # 9.56
    if preset == "modern":
        assert (value > 4 * ten_steps).all()  # each iteration adds ten steps
    elif algo == "trpo":
        np.testing.assert_allclose(value, ten_steps, atol=0.1)
    else:  # PPO's critic does not observe the step: it predicts a mean over 1 to 10 remaining steps
        assert ((value > 4) & (value < ten_steps + 0.5)).all()
