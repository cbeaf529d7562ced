"""Tasks of DeepMind Control as tasks of ours: the same states, observations and rewards, step by step."""

import importlib
from typing import Any

import numpy as np
import pytest

from planspace.cli.plan import Plan
from planspace.envs.batch import TaskBatch
from planspace.errors import UsageError
from planspace.tasks.catalog import find_task
from planspace.tasks.dm_control.suite import dmc_tasks
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem

pytest.importorskip("dm_control", reason="needs the extra robots")

NAMES = [
    ("acrobot-swingup", "acrobot", "swingup"),
    ("acrobot-swingup-sparse", "acrobot", "swingup_sparse"),
    ("cartpole-balance", "cartpole", "balance"),
    ("cartpole-balance-sparse", "cartpole", "balance_sparse"),
    ("cartpole-swingup", "cartpole", "swingup"),
    ("cartpole-swingup-sparse", "cartpole", "swingup_sparse"),
    ("cartpole-two-poles", "cartpole", "two_poles"),
    ("cartpole-three-poles", "cartpole", "three_poles"),
    ("pendulum-swingup", "pendulum", "swingup"),
    ("reacher-easy", "reacher", "easy"),
    ("reacher-hard", "reacher", "hard"),
]
"""Our name, dm_control's domain and its function."""
TOLERANCE = 1e-10


def test_every_task_is_compared() -> None:
    assert set(dmc_tasks()) == {name for name, _, _ in NAMES}


def same(found: Any, wanted: Any) -> None:
    np.testing.assert_allclose(found, wanted, rtol=0, atol=TOLERANCE)


@pytest.mark.filterwarnings("ignore")  # GLFW finds no display
@pytest.mark.parametrize(("name", "domain", "function"), NAMES)
def test_states_observations_and_rewards_are_those_of_dm_control(
    name: str, domain: str, function: str, rng: np.random.Generator
) -> None:
    task = find_task(f"dmc:{name}")
    env = getattr(importlib.import_module(f"dm_control.suite.{domain}"), function)(random=0)
    if isinstance(task.problem, Problem):
        load_problem(f"dmc:{name}")  # it is checked
    batch = TaskBatch(task, 1, threads=1)
    assert env.control_timestep() == task.frame_skip * batch.simulator.model.opt.timestep
    assert round(env._step_limit) == task.horizon
    rewards = []
    for start in ("theirs", "goal"):  # near the goal, sparse rewards are paid
        env.reset()
        physics = env.physics
        target = physics.named.model.geom_pos[["target"], :2] if domain == "reacher" else np.empty((1, 0))
        if start == "goal" and domain == "reacher":  # the law of cosines, for two links of equal length
            bend = 2 * np.arccos(np.linalg.norm(target) / 0.24)
            physics.data.qpos[:] = np.arctan2(target[0, 1], target[0, 0]) - bend / 2, bend
        elif start == "goal":
            physics.data.qpos[:] = 0.0
        physics.after_reset()
        batch.reset(np.concatenate([physics.data.qpos, physics.data.qvel])[None], target)
        for control in rng.uniform(-1, 1, (150, *env.action_spec().shape)):
            found, (reward, terminated, _) = env.step(control), batch.step(control[None])
            same(batch.states[0], np.concatenate([physics.data.qpos, physics.data.qvel]))
            same(reward, [found.reward])
            same(
                task.observe(batch.states, target)[0],
                np.concatenate([np.ravel(part) for part in found.observation.values()]),
            )
            assert not terminated
            rewards.append(found.reward)
    assert np.mean(rewards) > 0


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "domain", "function"),
    [
        row
        for row in NAMES
        if row[0] in ("acrobot-swingup", "cartpole-balance", "cartpole-two-poles", "reacher-hard")
    ],
)
def test_first_states_are_drawn_as_in_dm_control(
    name: str, domain: str, function: str, rng: np.random.Generator
) -> None:
    task = find_task(f"dmc:{name}")
    env = getattr(importlib.import_module(f"dm_control.suite.{domain}"), function)(random=0)
    theirs = []
    for _ in range(300):
        env.task.initialize_episode(env.physics)
        theirs.append(np.concatenate([env.physics.data.qpos, env.physics.data.qvel]))
    ours = task.sample_starts(300, rng)[0]
    std = np.std(theirs, axis=0)
    np.testing.assert_allclose(ours.mean(axis=0), np.mean(theirs, axis=0), rtol=0, atol=0.35 * std.max())
    np.testing.assert_allclose(ours.std(axis=0), std, rtol=0.2, atol=1e-12)


def test_an_unknown_name_is_refused_with_a_suggestion() -> None:
    with pytest.raises(UsageError, match="Did you mean 'acrobot-swingup'"):
        find_task("dmc:acrobot-swingupp")
    with pytest.raises(UsageError, match="has no planning problem, because its goal is not a state"):
        load_problem("dmc:reacher-hard")


def test_the_command_line_plans_with_settings() -> None:
    plan = Plan.default(["dmc:pendulum-swingup", "--settings", "polish_max_blocks=77", "--out", "plans"])
    assert plan.config.polish.max_blocks == 77
