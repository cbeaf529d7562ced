"""Episodes of a plan-space controller are plans: `--plans CONTROL_RUN/demos` makes the controller a guide."""

from pathlib import Path

import numpy as np

from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.control.runs import control_into
from planspace.demos.load import load_demos
from planspace.envs.episodes import TaskEpisodes
from planspace.rl.algorithms.sac import SAC
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.plans import Plans


def test_episodes_of_a_controller_are_starts_and_steps_of_training(tmp_path: Path) -> None:
    plant = Plant.find("cartpole-swingup")
    control = ControlConfig(cost="reward", samples=8, horizon_s=0.16, regulator=False)
    control_into(plant, None, control, tmp_path, num=2, seed=0, episode_s=1.0, workers=0)
    guide = load_demos(tmp_path / "episodes")
    config = TrainConfig(SAC(), resets=1.0, reset_schedule="reverse", replay=0.5, clone=10)
    plans = Plans.of(config, Observer(plant.task, "raw", "none", "both"), tmp_path / "episodes")
    assert plans is not None
    episodes = plans.episodes(TaskEpisodes(plant.task, 50))
    episodes.reset([np.random.default_rng(0)])
    late = np.concatenate([guide.episode(i).states[-3:] for i in range(2)])  # the last tenth of 25 steps
    assert (episodes.states[:, None] == late).all(axis=2).any(axis=1).all()
    steps = plans.transitions()
    assert steps is not None  # exactly what the controller did, since it acts once per step of the task
    np.testing.assert_allclose(steps.actions, guide.controls, atol=1e-5)
    states = [guide.episode(i).states[1:] for i in range(2)]
    np.testing.assert_allclose(steps.next_obs, np.concatenate(states), atol=1e-4)
