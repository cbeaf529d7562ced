"""A model whose time step is far too long: its physics run away, and nobody takes that for a state."""

import shutil
from dataclasses import replace
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.describe import replay_errors, validate
from planspace.demos.folder import DemoFolder, load_demos
from planspace.errors import PlanspaceError
from planspace.physics.simulate import ASSETS
from planspace.physics.space import StateSpace
from planspace.plan.generate import generate
from planspace.plan.planner import PlannerConfig
from planspace.plan.problem_file import load_problem
from planspace.rl import train as training
from planspace.rl.config import BATCH_STEPS, Algo, TrainConfig
from planspace.store import read_arrays
from planspace.tasks import Task, find_task

LONG_STEP_S = 1e6


def with_long_step(xml: str) -> str:
    """The model with a time step that no integrator bears."""
    changed = xml.replace('timestep="', f'timestep="{LONG_STEP_S}" was="')
    start = changed.index(' was="')
    end = changed.index('"', start + 6) + 1
    return changed[:start] + changed[end:]


def test_the_planner_finds_nothing_in_it(tmp_path: Path) -> None:
    for file in ASSETS.glob("*.xml"):
        shutil.copy(file, tmp_path)
    problem_file = shutil.copy(ASSETS / "cartpole-swingup.yaml", tmp_path)
    model = tmp_path / "cartpole.xml"
    model.write_text(with_long_step(model.read_text()))
    problem = load_problem(str(problem_file))
    config = PlannerConfig.for_problem(problem, restarts=1, sst_max_rounds=5, sst_min_rounds=1)
    with pytest.raises(PlanspaceError, match="found no way to the goal"):
        generate(problem, tmp_path / "demos", num=1, seed=0, config=config, workers=0)
    with pytest.raises(PlanspaceError, match="holds no demonstrations"):
        load_demos(tmp_path / "demos")


def test_a_dataset_that_does_not_replay_is_refused(demos: Demos, tmp_path: Path) -> None:
    info = replace(demos.info, mjcf=with_long_step(demos.info.mjcf))
    wild = replace(demos, info=info, times=demos.times * LONG_STEP_S / demos.times[1])
    DemoFolder(tmp_path, info, {}).append([wild.episode(i) for i in range(len(wild))], len(wild))
    with np.errstate(all="ignore"):
        assert not (replay_errors(wild) < 1.0).any()
        with pytest.raises(PlanspaceError, match="misses its states"):
            validate(tmp_path, replay_controls=True)


@pytest.fixture
def wild_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every task has the long step."""
    compile_task = Task.compile

    def compile_wild(task: Task) -> tuple[mujoco.MjModel, StateSpace]:
        model, space = compile_task(task)
        model.opt.timestep = LONG_STEP_S
        return model, space

    monkeypatch.setattr(Task, "compile", compile_wild)


@pytest.mark.usefixtures("wild_tasks")
@pytest.mark.parametrize("algo", ["trpo", "ppo"])
def test_training_on_it_stays_finite(algo: Algo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "BATCH_STEPS", 1000)
    config = TrainConfig("cartpole-swingup", algo, num_seeds=2, steps=2 * BATCH_STEPS)
    history = training.train(config, tmp_path)
    assert np.isfinite(history["return"]).all() and not history["frozen"].any()
    assert (history["length"] < find_task("cartpole-swingup").horizon).all()  # each episode ran away
    for file in ("policies.safetensors", "checkpoint/state.safetensors"):  # so was every gradient
        arrays = read_arrays(tmp_path / file)
        assert arrays and all(np.isfinite(x).all() for x in arrays.values() if x.dtype.kind == "f")


@pytest.mark.usefixtures("wild_tasks")
@pytest.mark.parametrize("task", ["CartPoleSwingUp", "ReacherRaw"])
def test_environments_end_the_episode_with_the_last_sound_state(task: str) -> None:
    env = gymnasium.make(f"planspace/{task}-v0").unwrapped
    before, _ = env.reset(seed=0)
    obs, reward, terminated, truncated, info = env.step(env.action_space.high)  # pyright: ignore
    assert truncated and not terminated and info["diverged"] and np.isfinite(reward)
    np.testing.assert_array_equal(obs, before)
