"""A model with a time step that is far too long: its physics diverge, which must never pass as a state."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.describe import replay_errors, validate
from planspace.demos.folder import DemoFolder
from planspace.demos.load import load_demos
from planspace.errors import PlanspaceError
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.rl import arm as arm_module
from planspace.rl import training
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.rl.rollout import Rollout
from planspace.storage.arrays import read_arrays
from planspace.tasks.catalog import find_task
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem
from planspace.tasks.task import Task

LONG_STEP_S = 1e6


def test_the_planner_takes_no_diverged_edge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`tests/physics/test_simulator.py` has an edge that only MuJoCo's warning marks as invalid."""
    compile_problem, propagate, edges = Problem.compile, Simulator.propagate, []

    def compile_diverging(problem: Problem) -> tuple[mujoco.MjModel, StateSpace]:
        model, space = compile_problem(problem)
        model.opt.timestep = LONG_STEP_S
        return model, space

    def watched(self: Simulator, *edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        ends, valid = propagate(self, *edge)
        edges.append(valid)
        return ends, valid

    problem = replace(load_problem("cartpole-swingup"), name="diverging")  # the planner is kept for a problem
    config = PlanConfig.for_problem(problem, restarts=1, sst_max_rounds=5, sst_min_rounds=1)
    monkeypatch.setattr(Problem, "compile", compile_diverging)
    monkeypatch.setattr(Simulator, "propagate", watched)
    with pytest.raises(PlanspaceError, match="found no way to the goal"):
        plan_into(problem, tmp_path / "demos", num=1, seed=0, config=config, workers=0)
    with pytest.raises(PlanspaceError, match="has no demonstrations"):
        load_demos(tmp_path / "demos")
    assert sum(map(len, edges)) > 100 and not np.concatenate(edges).any()


def test_a_dataset_that_does_not_replay_is_rejected(demos: Demos, tmp_path: Path) -> None:
    def stretched(step: float) -> Demos:
        return replace(demos, times=demos.times * step / demos.times[1])

    slow = stretched(1999.007)  # not a multiple of the model's step, so it is one step
    DemoFolder(tmp_path, slow.info, {}).append([slow.episode(i) for i in range(len(slow))], len(slow))
    with np.errstate(all="ignore"):
        assert not (replay_errors(slow) < 1.0).any()
        with pytest.raises(PlanspaceError, match="states that differ by up to"):
            validate(tmp_path, replay_controls=True)
    with pytest.raises(PlanspaceError, match="two states are 1e\\+06 s apart, more than 100000 steps"):
        replay_errors(stretched(1e6))  # a multiple: it would be that many steps


@pytest.mark.parametrize(
    ("array", "number"), [("states", 1e308), ("controls", -1e11), ("goals", np.inf), ("costs", -np.inf)]
)
def test_impossible_values_are_found(array: str, number: float, demos: Demos, tmp_path: Path) -> None:
    valid = replace(demos, costs=np.full(len(demos), np.nan), goals=np.full_like(demos.goals, np.nan))
    for name, given in (
        ("valid", valid),
        ("invalid", replace(valid, **{array: getattr(valid, array).copy()})),
    ):
        if name == "invalid":
            getattr(given, array)[-1] = number
        folder = DemoFolder(tmp_path / name, demos.info, {})
        folder.append([given.episode(i) for i in range(len(demos))], len(demos))
    assert validate(tmp_path / "valid", replay_controls=False)["demonstrations"] == len(demos)
    with pytest.raises(PlanspaceError, match=f"demonstration {len(demos) - 1} has a {array[:-1]} with"):
        validate(tmp_path / "invalid", replay_controls=False)


@pytest.fixture
def diverging_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give every task the long step."""
    compile_task = Task.compile

    def compile_diverging(task: Task) -> tuple[mujoco.MjModel, StateSpace]:
        model, space = compile_task(task)
        model.opt.timestep = LONG_STEP_S
        return model, space

    monkeypatch.setattr(Task, "compile", compile_diverging)


@pytest.mark.nightly
@pytest.mark.usefixtures("diverging_tasks")
@pytest.mark.parametrize("algo", ["trpo", "ppo"])
def test_training_on_diverging_physics_stays_finite(
    algo: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    collect = training.collect

    def collect_finite(*arguments: Any, **options: Any) -> Rollout:
        rollout = collect(*arguments, **options)
        for array in vars(rollout).values():
            assert np.isfinite(array).all()
        return rollout

    for module in (training, arm_module):
        monkeypatch.setattr(module, "collect", collect_finite)
    config = TrainConfig(find_algorithm(algo), num_seeds=2, steps=800, batch_steps=400)
    history = training.train_policies("cartpole-swingup", config, out=tmp_path).history
    assert np.isfinite(history["return"]).all() and not history["frozen"].any()
    assert (history["length"] < find_task("cartpole-swingup").horizon).all()  # each episode diverged
    for file in ("policies.safetensors", "checkpoint/state.safetensors"):  # every gradient was finite too
        arrays = read_arrays(tmp_path / file)
        assert arrays and all(np.isfinite(x).all() for x in arrays.values() if x.dtype.kind == "f")


@pytest.mark.usefixtures("diverging_tasks")
@pytest.mark.parametrize("task", ["CartPoleSwingUp", "ReacherRaw"])
def test_environments_end_a_diverged_episode_with_the_last_valid_state(task: str) -> None:
    env = gymnasium.make(f"planspace/{task}-v0").unwrapped
    before, _ = env.reset(seed=0)
    obs, reward, terminated, truncated, info = env.step(env.action_space.high)  # pyright: ignore
    assert truncated and not terminated and info["diverged"] and np.isfinite(reward)
    np.testing.assert_array_equal(obs, before)
