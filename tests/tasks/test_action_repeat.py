"""An action that is held for several steps: the states and summed rewards of as many single steps."""

from pathlib import Path

import numpy as np
import pytest

from planspace.envs.batch import TaskBatch
from planspace.errors import UsageError
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.config import TrainConfig
from planspace.rl.play import make_env, play
from planspace.rl.saved_policy import load_policy
from planspace.rl.training import train_policies
from planspace.tasks.action_repeat import repeat_actions, single_actions
from planspace.tasks.catalog import find_task
from planspace.tasks.gymnasium import GymTask
from planspace.tasks.task import Task

CARTPOLE = find_task("cartpole")


def repeated(task: Task, num: int) -> Task:
    found = repeat_actions(task, num)
    assert isinstance(found, Task)
    return found


def test_an_action_is_held_and_its_rewards_are_summed(rng: np.random.Generator) -> None:
    task = find_task("pendulum-swingup")
    held, single = TaskBatch(repeated(task, 4), 3, threads=1), TaskBatch(task, 3, threads=1)
    starts = task.sample_starts(3, rng)
    for batch in (held, single):
        batch.reset(*starts)
    for action in rng.uniform(-9, 9, (5, 3, 1)):  # beyond the limits, too
        reward = held.step(action)[0]
        np.testing.assert_allclose(reward, sum(single.step(action)[0] for _ in range(4)), rtol=1e-12)
        np.testing.assert_array_equal(held.states, single.states)


def test_nothing_is_earned_after_an_episode_ended() -> None:
    batch = TaskBatch(repeated(CARTPOLE, 5), 2, threads=1)
    batch.reset(np.array([[0.0, 0.19, 0.0, 2.0], [0.0, 0.0, 0.0, 0.0]]), np.empty((2, 0)))
    reward, terminated, _ = batch.step(np.zeros((2, 1)))
    assert reward.tolist() == [1.0, 5.0] and terminated.tolist() == [True, False]
    assert 0.2 < batch.states[0, 1] < 0.3  # 0.19 + 0.04 s * 2 rad/s: it stays where it ended


def test_the_horizon_counts_actions() -> None:
    task = repeated(CARTPOLE, 4)
    assert (task.horizon, task.action_repeat) == (25, 4)
    assert repeated(task, 2).horizon == 50 and single_actions(task) == CARTPOLE
    assert task.hash != CARTPOLE.hash


@pytest.mark.parametrize(
    ("task", "num", "problem"),
    [
        (CARTPOLE, 0, "`action_repeat` must be a whole number of at least 1, got 0"),
        (CARTPOLE, 3, "--action-repeat 3 must divide the 100 steps of cartpole"),
        (GymTask("Pendulum-v1"), 2, "but gym:Pendulum-v1 is a Gymnasium environment"),
    ],
)
def test_what_does_not_fit_is_refused(task: Task | GymTask, num: int, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        repeat_actions(task, num)


@pytest.mark.slow
def test_training_counts_environment_steps_and_playing_repeats_actions(tmp_path: Path) -> None:
    config = TrainConfig(TRPO(), num_seeds=1, steps=400, batch_steps=200, action_repeat=2)
    trained = train_policies(CARTPOLE, config, out=tmp_path / "run", verbose=False)
    assert trained.history["steps"].tolist() == [200, 400] and trained.history["eval_steps"].tolist() == [400]
    policy = load_policy(tmp_path / "run")
    returns, episodes = play(policy, 1, 0)
    states = episodes.episode(0)
    assert np.diff(states.times)[0] == pytest.approx(0.08)  # two control steps of 0.04 s
    assert len(states.controls) <= returns[0] <= 2 * len(states.controls)
    assert make_env(policy).unwrapped.task.action_repeat == 2  # pyright: ignore
