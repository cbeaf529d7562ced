"""Tasks of DeepMind Control as tasks of ours: the same states, observations and rewards."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from planspace.envs.batch import TaskBatch
from planspace.tasks.problem_file import load_problem

pytest.importorskip("dm_control", reason="needs the extra robots")


@pytest.mark.filterwarnings("ignore")  # GLFW finds no display
@pytest.mark.parametrize(
    ("file", "domain", "name"),
    [("dmc_acrobot", "acrobot", "swingup"), ("dmc_two_poles", "cartpole", "two_poles")],
)
def test_states_and_rewards_are_those_of_dm_control(
    file: str, domain: str, name: str, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    task = importlib.import_module(file).TASK
    env = getattr(importlib.import_module(f"dm_control.suite.{domain}"), name)(random=0)
    load_problem(task.problem)  # it is checked
    batch = TaskBatch(task, 1, threads=1)
    assert env.control_timestep() == batch.simulator.model.opt.timestep and task.horizon == 1000
    none = np.empty((1, 0))
    for _ in range(2):
        env.reset()
        physics = env.physics
        batch.reset(np.concatenate([physics.data.qpos, physics.data.qvel])[None], none)
        for control in rng.uniform(-1, 1, (200, 1)):
            found, (reward, _, _) = env.step(control), batch.step(control[None])
            wanted = np.concatenate([physics.data.qpos, physics.data.qvel])
            np.testing.assert_allclose(batch.states[0], wanted, rtol=0, atol=1e-10)
            np.testing.assert_allclose(reward, [found.reward], rtol=0, atol=1e-10)
            observed = np.concatenate([np.ravel(part) for part in found.observation.values()])
            np.testing.assert_allclose(task.observe(batch.states, none)[0], observed, rtol=0, atol=1e-10)
