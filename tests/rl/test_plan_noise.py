"""Steps beside plans, with controls that lead back to them."""

from dataclasses import replace
from pathlib import Path

import gymnasium.envs.mujoco
import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.envs.batch import TaskBatch
from planspace.errors import UsageError
from planspace.plan.linearise import time_varying_lqr
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.plan_steps import COPIES, beside_plans
from planspace.rl.plans import Plans
from planspace.rl.settable import SettableTask
from planspace.tasks.catalog import TASKS
from planspace.tasks.gymnasium import AnyTask, GymTask

TASK = TASKS["cartpole-swingup"]
CLONING = TrainConfig(num_seeds=1, clone=1)


def plans_of(demos: Demos, noise: float, task: AnyTask = TASK) -> Plans:
    found = Plans.of(replace(CLONING, plan_noise=noise), Observer(task, "raw", "none", "both"), demos)
    assert found is not None
    return found


def test_gains_of_several_trajectories_whose_last_step_repeats_are_those_of_each(
    rng: np.random.Generator,
) -> None:
    a, b = np.eye(3) + 0.1 * rng.normal(size=(6, 3, 3)), rng.normal(size=(6, 3, 1))
    costs = np.ones(3), np.full(1, 0.1)
    gains, values = time_varying_lqr(a, b, *costs, np.array([2, 3, 4, 5, -1, -1]), end_repeats=200)
    for rows in ([0, 2, 4], [1, 3, 5]):  # two trajectories, whose rows alternate
        repeated = rows + [rows[-1]] * 199
        expected = time_varying_lqr(a[repeated], b[repeated], *costs)
        for found, right in zip((gains, values), expected, strict=True):
            np.testing.assert_allclose(found[rows], right[:3], rtol=1e-9)


def test_steps_beside_plans_follow_those_along_them_and_are_the_task_s(demos: Demos) -> None:
    along, found = plans_of(demos, 0.0).transitions(), plans_of(demos, 0.05).transitions()
    assert along is not None and found is not None
    count = len(along.rewards)
    assert len(found.rewards) == (1 + COPIES) * count
    for part, whole in zip(along, found, strict=True):
        np.testing.assert_array_equal(part, whole[:count])
    moves = (found.obs[count:] - np.tile(along.obs, (COPIES, 1))) / along.obs.std(axis=0)
    assert 0.4 * 0.05 < moves.std() < 0.05 and np.abs(moves).max() > 0.1  # a uniform factor: 1/sqrt(3)
    batch = TaskBatch(TASK, 50)
    rows = np.random.default_rng(0).integers(count, len(found.rewards), 50)
    batch.reset(found.obs[rows].astype(float), np.zeros((50, 0)))
    rewards, _, _ = batch.step(found.actions[rows])
    np.testing.assert_allclose(batch.states, found.next_obs[rows], atol=1e-4)  # observations are float32
    np.testing.assert_allclose(rewards, found.rewards[rows], atol=1e-4)


def test_the_controls_lead_back(rng: np.random.Generator) -> None:
    """Beside plans of a pole that stands up, they are those of a regulator that holds it up."""
    states, settable = 0.01 * rng.normal(size=(40, 4)), SettableTask(TASK, "dense")
    following = np.full(40, -1)
    beside, controls = beside_plans(settable, states, np.zeros((40, 1)), following, 1.0)
    moves = beside - np.tile(states, (COPIES, 1))
    gain = np.linalg.lstsq(moves, controls, rcond=None)[0]
    assert np.abs(controls - moves @ gain).max() < 0.05 * np.abs(controls).max()
    batch, angles = TaskBatch(TASK, 1), {}
    for name, slope in {"regulated": gain, "free": 0 * gain}.items():
        batch.reset(np.array([[0.0, 0.05, 0.0, 0.0]]), np.zeros((1, 0)))
        for _ in range(100):
            batch.step(batch.states @ slope)
        angles[name] = abs(batch.states[0, 1])
    assert angles["regulated"] < 0.01 < 0.5 < angles["free"]


def test_where_servos_drive_a_robot_only_their_joints_move_and_the_plan_s_control_leads_back(
    demos: Demos, tmp_path: Path
) -> None:
    own = Path(gymnasium.envs.mujoco.__file__).with_name("assets") / "inverted_pendulum.xml"
    text = own.read_text().replace("<motor ctrllimited", "<position ctrllimited")
    (tmp_path / "servo.xml").write_text(text.replace('gear="100"', 'kp="1000"'))
    task = GymTask("InvertedPendulum-v5", kwargs={"xml_file": str(tmp_path / "servo.xml")})
    steps = plans_of(demos, 0.2, task).transitions()
    assert steps is not None
    count = len(steps.actions) // (1 + COPIES)
    np.testing.assert_array_equal(steps.actions, np.tile(steps.actions[:count], (1 + COPIES, 1)))
    before, after = (obs[count:] - np.tile(obs[:count], (COPIES, 1)) for obs in (steps.obs, steps.next_obs))
    assert not before[:, [1, 3]].any()  # the pole has no actuator
    assert (before[:, [0, 2]].std(axis=0) > 0).all()
    slopes = np.linalg.lstsq(before[:, [0, 2]], after[:, 2] - before[:, 2])[0]
    assert slopes[0] < -1  # it is pulled back


def test_what_cannot_be_done_is_refused(demos: Demos) -> None:
    with pytest.raises(UsageError, match="no step along plans is used: set `replay` or `clone`"):
        TrainConfig(resets=0.5, plan_noise=0.1)
    with pytest.raises(UsageError, match="plan_noise"):
        TrainConfig(clone=1, plan_noise=-0.1)
    with pytest.raises(UsageError, match="all position servos, unlike gym:InvertedPendulum-v5"):
        plans_of(demos, 0.1, GymTask("InvertedPendulum-v5"))
