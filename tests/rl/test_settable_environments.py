"""Plans in the training on Gymnasium environments: their states are set, and their steps taken."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.envs.episodes import make_episodes
from planspace.envs.gymnasium_env import GymTaskEnv
from planspace.errors import PlanspaceError, UsageError
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.plans import Plans
from planspace.rl.sac_agent import SAC
from planspace.rl.training import train_policies
from planspace.rl.transitions import Transitions
from planspace.tasks.catalog import TASKS
from planspace.tasks.gymnasium import AnyTask, GymTask

from . import tiny_gym_envs
from .test_uses_of_plans import Replaying

DOOR = Path(__file__).parents[3] / "shared" / "data" / "adroit-door-human" / "door_human.npz"
REPLAY = TrainConfig(Replaying(), num_seeds=1, replay=0.5)
assert tiny_gym_envs


def transitions(task: AnyTask, demos: Demos) -> Transitions:
    plans = Plans.of(REPLAY, Observer(task, "raw", "none", "both"), demos)
    assert plans is not None
    steps = plans.transitions()
    assert steps is not None
    return steps


def demos_of(names: tuple[str, ...], states: np.ndarray, controls: np.ndarray, dt: float) -> Demos:
    """One demonstration without a model."""
    info = StateInfo(names, ("",) * len(names), (), controls.shape[1])
    times = dt * np.arange(len(states))
    return Demos.from_episodes(info, [Episode(states, controls, times, states[-1], True, 0, 0)])


def test_transitions_of_a_task_are_the_same_through_gymnasium(demos: Demos) -> None:
    own, through = transitions(TASKS["cartpole"], demos), transitions(GymTask("planspace/CartPole-v0"), demos)
    ended = (
        np.abs(through.obs[:, 1]) > 0.2
    )  # where an environment would have ended is not known before a step
    assert ended.any()
    for a, b in zip(own, through, strict=True):
        np.testing.assert_array_equal(a, b[~ended])


def test_transitions_are_steps_of_gymnasiums_mujoco_environment(demos: Demos) -> None:
    task = GymTask("InvertedPendulum-v5")
    found, env = transitions(task, demos), task.make()
    inner: Any = env.unwrapped
    for row in (0, len(found.rewards) // 2, len(found.rewards) - 1):
        env.reset(seed=0)
        inner.set_state(found.obs[row, :2].astype(float), found.obs[row, 2:].astype(float))
        obs, reward, terminated, _, _ = env.step(found.actions[row])
        np.testing.assert_allclose(found.next_obs[row], obs, atol=1e-5)
        assert (found.rewards[row], found.terminated[row]) == (reward, terminated)


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_episodes_start_at_plans_and_the_others_as_without_plans(workers: int, demos: Demos) -> None:
    task = GymTask("InvertedPendulum-v5")
    usual, own = make_episodes(task, 12), make_episodes(task, 12, workers=workers)
    usual.reset([np.random.default_rng(s) for s in (0, 1)])
    plans = Plans.of(
        TrainConfig(num_seeds=2, resets=0.5), Observer(task, "raw", "none", "both", (), 2), demos
    )
    assert plans is not None
    started = plans.episodes(own)
    started.reset([np.random.default_rng(s) for s in (0, 1)])
    changed = (started.states != usual.states).any(axis=1)
    assert 0 < changed.sum() < 12
    states = started.states[changed]
    assert (states[:, None, 4:] == demos.states).all(axis=2).any(axis=1).all()
    np.testing.assert_array_equal(states[:, :4], states[:, 4:])  # the observation is that of the new state
    steps = started.step(np.zeros((12, 1)))
    assert np.isfinite(started.states).all() and not steps.timeout.any()
    started.close()
    usual.close()


def test_training_on_an_environment_uses_plans(demos: Demos) -> None:
    task = GymTask("InvertedPendulum-v5", max_episode_steps=50)
    algorithm = SAC(batch=32, learning_starts=50, hidden=(16, 16), critic_hidden=(16, 16))
    config = TrainConfig(algorithm, num_seeds=1, steps=150, batch_steps=50, resets=0.5, replay=0.5)
    history = train_policies(task, config, plans=demos).history
    assert np.isfinite(history["return"]).all() and not history["frozen"].any()


class Stubborn(gymnasium.Env):
    """A number that `reset` sets to 0, whatever its options say."""

    state_names = ("x",)
    observation_space, action_space = Box(-9, 9, (1,)), Box(-1, 1, (1,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        self.state = np.zeros(1, np.float32)
        return self.state, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        return self.state, 0.0, False, False, {}


def test_an_environment_that_ignores_the_state_is_refused() -> None:
    gymnasium.register("tiny/Stubborn-v0", lambda **_: Stubborn(), max_episode_steps=5)
    demos = demos_of(("x",), np.array([[0.0], [0.5], [0.0]]), np.ones((2, 1)), 1 / 30)
    with pytest.raises(PlanspaceError, match=r"cannot start an episode at a given state: x was set to 0\.5"):
        transitions(GymTask("tiny/Stubborn-v0"), demos)


@pytest.mark.filterwarnings("default")  # the wrapper warns
def test_an_environment_whose_wrapper_changes_observations_is_refused(demos: Demos) -> None:
    gymnasium.register(
        "tiny/Scaled-v0",
        "gymnasium.envs.mujoco.inverted_pendulum_v5:InvertedPendulumEnv",
        max_episode_steps=9,
        additional_wrappers=(gymnasium.wrappers.DtypeObservation.wrapper_spec(dtype=np.float32),),
    )
    task = GymTask("tiny/Scaled-v0")
    with pytest.raises(UsageError, match="which gym:tiny/Scaled-v0 does not allow: leave it out"):
        train_policies(task, TrainConfig(num_seeds=1, resets=0.5), plans=demos)


@pytest.mark.filterwarnings("default")  # the package warns
def test_a_door_is_set_with_the_hand() -> None:
    pytest.importorskip("gymnasium_robotics", reason="needs the extra robots")
    task = GymTask("AdroitHandDoorSparse-v1")
    names = task.sizes.settable_names
    assert len(names) == 63 and names[-3:] == ("door_body_pos_0", "door_body_pos_1", "door_body_pos_2")
    first, second = GymTaskEnv(task), GymTaskEnv(task)
    rng = np.random.default_rng(0)
    first.reset(seed=1)
    for _ in range(20):
        first.step(rng.uniform(-1, 1, 28))
    columns = [task.state_names.index(name) for name in names]
    second.reset(seed=2)
    obs = second.set_state(first.state[columns])
    places = slice(29, 38)  # of palm and handle, which a step computes at the start of its last 2 ms
    np.testing.assert_allclose(np.delete(obs, places), np.delete(first.state[:39], places), atol=1e-6)
    np.testing.assert_allclose(obs, first.state[:39], atol=0.01)
    action = rng.uniform(-1, 1, 28)
    a, b = first.step(action), second.step(action)
    np.testing.assert_allclose(a[0], b[0], atol=1e-3)  # contacts are warm-started
    assert a[1] == b[1]
