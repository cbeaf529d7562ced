import numpy as np
import pytest

from planspace.envs.episodes import TaskEpisodes
from planspace.errors import UsageError
from planspace.rl.config import BATCH_STEPS
from planspace.rl.observe import Observer
from planspace.rl.rollout import Rollout, collect, episode_returns, first_episodes
from planspace.rl.training import num_episodes
from planspace.tasks.catalog import TASKS
from planspace.tasks.task import Task


def roll(task: Task, num_envs: int, seeds: list[int], num_steps: int) -> Rollout:
    """Episodes with unit Gaussian noise for actions."""
    episodes = TaskEpisodes(task, num_envs * len(seeds))
    rngs = [np.random.default_rng(s) for s in seeds]
    return collect(episodes, Observer(task, "raw", "none", "both"), lambda obs, noise: noise, num_steps, rngs)


def test_episodes_of_a_seed_do_not_depend_on_other_seeds() -> None:
    task = TASKS["cartpole"]  # its episodes end early, so restarts also draw random numbers
    together, alone = roll(task, 4, [7, 8, 9], 60), roll(task, 4, [8], 60)
    assert together.terminated[:, 1].any()
    np.testing.assert_array_equal(together.obs[:, 1], alone.obs[:, 0])
    np.testing.assert_array_equal(together.actions[:, 1], alone.actions[:, 0])
    assert (together.obs[:, 0] != together.obs[:, 1]).any()


def test_terminated_timeout_and_cut_are_distinguished() -> None:
    balance = roll(TASKS["cartpole"], 4, [0], 60)
    assert balance.terminated.any() and not balance.timeout.any()
    assert (balance.cut[-1] == ~balance.terminated[-1]).all() and not balance.cut[:-1].any()
    assert (
        balance.step[1:][balance.terminated[:-1]] == 0
    ).all()  # the step after an end is the first of an episode
    swing_up = roll(TASKS["cartpole-swingup"], 2, [0], 200)
    assert swing_up.timeout[-1].all() and not swing_up.timeout[:-1].any()
    assert not (swing_up.terminated.any() or swing_up.cut.any())


def test_returns_are_means_over_ended_episodes() -> None:
    rollout = roll(TASKS["cartpole"], 4, [0, 1], 60)
    returns, lengths = episode_returns(rollout)
    np.testing.assert_array_equal(returns, lengths)  # each step has reward 1
    for s in range(2):
        ends = [np.diff([-1, *np.flatnonzero(rollout.terminated[:, s, e])]) for e in range(4)]
        assert lengths[s] == pytest.approx(np.concatenate(ends).mean())


def test_an_evaluation_uses_the_first_episode_of_each_environment() -> None:
    rollout = roll(TASKS["cartpole"], 4, [0, 1], 100)
    ends = [[np.flatnonzero(rollout.terminated[:, s, e])[0] + 1 for e in range(4)] for s in range(2)]
    np.testing.assert_array_equal(first_episodes(rollout).sum(axis=0), ends)


def test_actions_of_another_shape_are_refused() -> None:
    task = TASKS["cartpole"]
    rngs = [np.random.default_rng(0)] * 2
    message = r"Algorithm.collect must act with shape \[seed, env, action\] = \(2, 3, 1\), got \(2, 3\)\. See"
    with pytest.raises(UsageError, match=message):
        observer = Observer(task, "raw", "none", "both")
        collect(TaskEpisodes(task, 6), observer, lambda obs, noise: noise[..., 0], 5, rngs)


def test_iterations_consist_of_whole_episodes() -> None:
    assert {name: num_episodes(task, BATCH_STEPS) for name, task in TASKS.items()} == {
        "cartpole": 40,
        "cartpole-swingup": 20,
        "reacher-trig": 40,
        "reacher-raw": 40,
        "pendulum-swingup": 20,
        "acrobot-swingup": 13,  # of 300 steps: 3900
        "quadrotor-planar": 27,  # of 150: 4050
        "quadrotor": 27,
        "arm": 27,
    }
