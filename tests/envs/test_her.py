import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest

from planspace.envs.wrappers import PlanSpaceObservation, PlanSpaceShaping
from planspace.errors import UsageError

from .goal_env import COLUMNS, GOAL, point_embedding, point_env

pytest.importorskip("stable_baselines3", reason="needs the extra sb3")

from stable_baselines3 import SAC, HerReplayBuffer

from planspace.envs.her import PlanSpaceHerReplayBuffer

E = point_embedding()


def shaped(env: gymnasium.Env) -> gymnasium.Env:
    return PlanSpaceShaping(env, E, GOAL, columns=COLUMNS)


def both() -> gymnasium.Env:
    return PlanSpaceObservation(shaped(point_env()), E, columns=COLUMNS, goal=GOAL)


def agent(env: gymnasium.Env, buffer: Any = PlanSpaceHerReplayBuffer) -> SAC:
    return SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=buffer,
        learning_starts=20,
        policy_kwargs={"net_arch": [8]},
        batch_size=32,
        device="cpu",
        seed=0,
    )


def at_rest(goals: np.ndarray) -> np.ndarray:
    return np.concatenate([goals, np.zeros_like(goals)], axis=-1)


def test_relabelled_steps_have_the_z_and_the_reward_of_their_goals() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        learned = agent(both()).learn(40)
    buffer = learned.replay_buffer
    assert isinstance(buffer, PlanSpaceHerReplayBuffer)
    np.random.seed(0)  # noqa: NPY002
    batch = buffer.sample(200)
    own = {tuple(goal) for goal in buffer.observations["desired_goal"][:40, 0].astype(np.float32).tolist()}
    seen: list[dict[str, np.ndarray]] = []
    for entries in (batch.observations, batch.next_observations):
        obs = {key: values.numpy() for key, values in entries.items()}
        seen.append(obs)
        for name in ("achieved_goal", "desired_goal"):
            np.testing.assert_allclose(obs[f"z_{name}"], E.encode(at_rest(obs[name])), atol=1e-5)
        np.testing.assert_allclose(
            obs["z_difference"], obs["z_desired_goal"] - obs["z_achieved_goal"], atol=1e-6
        )
    before, after = seen
    goals = before["desired_goal"]
    assert sum(tuple(goal) not in own for goal in goals.tolist()) > 100  # relabelled
    reached = np.linalg.norm(after["achieved_goal"] - goals, axis=-1) <= 0.3
    terminated = np.abs(after["achieved_goal"]).max(axis=-1) > 2
    potentials = [-E.distance(obs["observation"], at_rest(goals)) for obs in seen]
    shaping = 0.99 * np.where(terminated, 0.0, potentials[1]) - potentials[0]
    np.testing.assert_allclose(batch.rewards.numpy()[:, 0], reached - 1.0 + shaping, atol=1e-4)


def test_sb3s_own_buffer_is_reported_where_it_would_be_wrong() -> None:
    shown = PlanSpaceObservation(point_env(), E, columns=COLUMNS, goal=GOAL)
    with pytest.warns(UserWarning, match=r"use planspace.envs.her.PlanSpaceHerReplayBuffer"):
        agent(shown, HerReplayBuffer).learn(25)
    with pytest.raises(UsageError, match="HerReplayBuffer with copy_info_dict=True"):
        agent(shaped(point_env()), HerReplayBuffer).learn(25)
    only_z = PlanSpaceObservation(point_env(), E, columns=COLUMNS)
    agent(only_z, HerReplayBuffer).learn(25)


@pytest.mark.nightly
def test_a_saved_buffer_asks_the_environment_again(tmp_path) -> None:
    learned = agent(both()).learn(25)
    learned.save_replay_buffer(tmp_path / "buffer")
    again = agent(both())
    again.load_replay_buffer(tmp_path / "buffer", truncate_last_traj=False)
    assert isinstance(again.replay_buffer, PlanSpaceHerReplayBuffer)
    obs = again.replay_buffer.sample(20).observations
    wanted = E.encode(at_rest(obs["desired_goal"].numpy()))
    np.testing.assert_allclose(obs["z_desired_goal"].numpy(), wanted, atol=1e-5)
