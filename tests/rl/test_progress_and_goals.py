"""The reward `progress`, and z of the goal in the observation."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace import load_policy
from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.time_head import TimeHead
from planspace.envs.episodes import TaskEpisodes
from planspace.errors import UsageError
from planspace.rl.algorithms.sac import SAC
from planspace.rl.arm import Arm
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.plans import Plans
from planspace.rl.play import make_env, play
from planspace.rl.progress import Progress
from planspace.rl.shaping import Shaping
from planspace.rl.training import train_policies
from planspace.seams import plain_settings
from planspace.tasks.catalog import TASKS

from ..embed.random_encoder import random_encoder
from .reaches import reaches

TASK = TASKS["cartpole-swingup"]
LARGEST = TimeHead([np.concatenate([np.eye(4), -np.eye(4)]).astype(np.float32)], [np.zeros(8, np.float32)])
"""Estimates the largest difference between two states, as max (b - a, a - b)."""
PAID = TrainConfig(reward="progress", num_seeds=2, steps=800, batch_steps=400)


def timed(names: tuple[str, ...]) -> Embedding:
    return replace(random_encoder("raw", (), names=names), time_head=LARGEST)


def test_progress_is_the_decrease_of_the_time_to_go() -> None:
    embedding = timed(TASK.state_names)
    for embeddings in ((embedding,), (embedding, embedding)):
        progress = Progress.of(PAID, TASK, embeddings)
        assert progress is not None
        before = np.array([[0.5, 3.0, 0, 0], [0, 1.0, -2.0, 0], [0, 0, 0, 0], [0, 0, 0, -1.0]])
        after = np.array([[0.5, 2.5, 0, 0], [0, 1.0, -2.25, 0], [0, 0, 1.0, 0], [0, 0, 0, 0]])
        # the goal is 0, so the times are 3 to 2.5, 2 to 2.25, 0 to 1 and 1 to 0
        np.testing.assert_allclose(progress(before, after, np.empty((4, 0))), [0.5, -0.25, -1.0, 1.0])


def test_shaping_by_time_has_minus_the_time_to_go_as_its_potential() -> None:
    config = TrainConfig(shaping="time", shaping_scale=6.0, num_seeds=1)
    embedding = timed(TASK.state_names)
    shaping = Shaping.of(config, TASK, (embedding,))
    assert shaping is not None
    starts, _ = TASK.sample_starts(1000, np.random.default_rng(0))
    unit = 6.0 / np.abs(starts).max(axis=1).mean()  # the scale for a second; the goal is 0
    before, after = np.array([[0.0, 3.0, 0, 0]]), np.array([[0.0, 2.5, 0, 0]])
    paid = shaping.reward_fn(0.9, True)(before, after, *np.zeros((2, 1), bool))
    np.testing.assert_allclose(paid, unit * (3.0 - 0.9 * 2.5), rtol=1e-6)
    with pytest.raises(UsageError, match="shaping by 'time' needs an embedding with a time head"):
        Shaping.of(config, TASK, (replace(embedding, time_head=None),))
    with pytest.raises(UsageError, match="shaping by 'time' needs an embedding: give --embedding DIR"):
        Shaping.of(config, TASK, ())


def test_progress_is_to_the_goal_of_the_episode() -> None:
    task, plans = reaches()
    config = replace(PAID, algorithm=SAC(), num_seeds=1, replay=0.5)
    progress = Progress.of(config, task, (timed(task.state_names),))
    found = Plans.of(config, Observer(task, "raw", "none", "both"), plans, progress)
    assert found is not None
    steps = found.transitions()
    assert steps is not None
    goal = np.array([0.3, 0.1, 0.0, 0.0])  # of the first plan
    first = np.abs(plans.episode(0).states - goal).max(axis=1)
    np.testing.assert_allclose(steps.rewards[:5], first[:-1] - first[1:], atol=1e-5)


def test_progress_is_paid_and_the_tasks_reward_is_reported() -> None:
    rollouts = {}
    for reward in ("progress", "dense"):
        config = replace(PAID, reward=reward)
        progress = Progress.of(config, TASK, (timed(TASK.state_names),))
        arm = Arm(config, Observer(TASK, "raw", "none", "both"), TaskEpisodes(TASK, 4), progress=progress)
        rollouts[reward] = arm.rollout(lambda obs, noise: noise, [np.random.default_rng(s) for s in (0, 1)])
    paid, usual = rollouts["progress"], rollouts["dense"]
    np.testing.assert_array_equal(paid.rewards, usual.rewards)
    times = [np.abs(x).max(axis=-1) for x in (paid.obs[0], paid.next_obs[-1])]
    np.testing.assert_allclose((paid.rewards + paid.shaping).sum(axis=0), times[0] - times[1], atol=1e-4)
    assert not usual.shaping.any()


def test_z_of_the_goal_its_direction_and_distance_are_observed(rng: np.random.Generator) -> None:
    task, _ = reaches()
    embedding = random_encoder("raw", (), names=task.state_names)
    states, targets = rng.normal(size=(6, 4)), rng.normal(size=(6, 4))
    targets[0] = states[0]
    observer = Observer(task, "raw", "augment", "policy", (embedding,), num_seeds=2, goal="z")
    obs = observer(states, targets)
    z, z_goal = embedding.encode(states), embedding.encode(targets)
    distance = np.linalg.norm(z_goal - z, axis=1, keepdims=True)
    unit = (z_goal - z) / np.where(distance == 0, 1.0, distance)
    own = task.observe_as("raw", states, targets)
    expected = np.concatenate([own, z, z_goal, unit, distance], axis=1)
    np.testing.assert_allclose(obs, expected, rtol=1e-4, atol=1e-4)
    assert observer.num_obs == observer.num_policy_obs == own.shape[1] + 10
    np.testing.assert_allclose(obs[:, observer.critic_columns], own, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_a_policy_that_sees_its_goal_in_z_is_saved_and_played(embedding: Embedding, tmp_path: Path) -> None:
    head = TimeHead([np.ones((2, len(embedding.inputs.mean)), np.float32)], [np.zeros(2, np.float32)])
    config = replace(PAID, num_seeds=1, z="replace", goal="z")
    embedding = replace(embedding, time_head=head)
    train_policies(TASK, config, embedding=embedding, out=tmp_path)
    policy = load_policy(tmp_path, 0)
    assert (policy.about["reward"], policy.about["goal"]) == ("dense", "z")
    assert policy.about["num_obs"] == 3 * embedding.z_dim + 1
    returns, _ = play(policy, 1, seed=3)
    assert np.isfinite(returns).all()
    env = make_env(policy)
    obs, info = env.reset(seed=3)
    z, z_goal = embedding.encode(info["state"]), embedding.encode(np.zeros(4))
    np.testing.assert_allclose(obs[: 2 * len(z)], np.concatenate([z, z_goal]), atol=1e-5)
    assert obs[-1] == pytest.approx(np.linalg.norm(z_goal - z), rel=1e-4)


REFUSED: dict[str, tuple[Any, dict[str, Any], str]] = {
    "no embedding": (TASK, {}, "--reward progress needs an embedding with a time head"),
    "targets": ("reacher-raw", {}, "--reward progress needs one goal, but reacher-raw has another target"),
    "gymnasium": (
        "gym:InvertedPendulum-v5",
        {},
        "--reward progress needs a goal, but gym:Inv.* has none",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_progress_lacks_is_refused(case: str) -> None:
    task, changes, message = REFUSED[case]
    with pytest.raises(UsageError, match=message):
        train_policies(task, replace(PAID, **changes))


def test_settings_and_embeddings_that_do_not_fit_are_refused(demos: Demos) -> None:
    with pytest.raises(UsageError, match="is paid instead of shaping rewards"):
        TrainConfig(reward="progress", shaping="raw")
    with pytest.raises(UsageError, match="goal is 'z', but there is no z"):
        TrainConfig(goal="z")
    with pytest.raises(UsageError, match="needs an embedding with a time head"):
        train_policies(TASK, PAID, embedding=random_encoder("raw", (), names=TASK.state_names))
    other = random_encoder("raw", (), names=TASKS["reacher-raw"].state_names)
    with pytest.raises(UsageError, match="--goal z needs one goal, but reacher-raw has another target"):
        train_policies("reacher-raw", TrainConfig(z="augment", goal="z", num_seeds=1), embedding=other)
    with pytest.raises(UsageError, match="--replay needs one embedding for all seeds, got 2"):
        both = [timed(TASK.state_names)] * 2
        train_policies(TASK, replace(PAID, algorithm=SAC(), replay=0.5), embedding=both, plans=demos)
    assert not {"goal"} & plain_settings(TrainConfig()).keys()
