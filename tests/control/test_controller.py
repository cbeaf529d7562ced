"""The controller does what is best on problems whose answer is known, and refuses what does not fit."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace import Controller, Embedding, PlanspaceError, UsageError, load_problem, make_env
from planspace.control.config import ControlConfig
from planspace.control.costs import make_cost, support_note
from planspace.control.episodes import run_episode
from planspace.control.methods import METHODS
from planspace.control.plant import Plant
from planspace.embed.time_head import TimeHead
from planspace.mjcf.assets import ASSETS
from planspace.tasks.catalog import TASKS
from planspace.tasks.problem import Problem

BY_REWARD = ControlConfig(horizon_s=0.4, samples=32, cost="reward", regulator=False)
HANGING, UPRIGHT = np.array([np.pi, 0.0]), np.array([0.05, 0.0])


@pytest.mark.parametrize("method", METHODS)
def test_a_falling_pendulum_is_pushed_back(method: str) -> None:
    controller = Controller("pendulum", config=replace(BY_REWARD, method=METHODS[method]))
    for side in (-1.0, 1.0):
        controller.reset(0)
        assert side * controller(side * np.array([0.3, 0.5]))[0] < 0


def test_the_regulator_takes_over_where_it_holds_the_goal_and_nowhere_else() -> None:
    controller = Controller("pendulum", config=replace(BY_REWARD, regulator=True))
    controller(UPRIGHT)
    assert controller.regulated
    controller(HANGING)
    assert not controller.regulated


def test_the_seed_decides_the_samples_and_threads_do_not() -> None:
    one, other = (Controller("pendulum", config=BY_REWARD, seed=3, threads=n) for n in (1, 2))
    first = [one(HANGING) for _ in range(3)]
    assert [other(HANGING) for _ in range(3)] == first
    one.reset(3)
    assert [one(HANGING) for _ in range(3)] == first
    one.reset(4)
    assert [one(HANGING) for _ in range(3)] != first


def test_a_control_is_held_for_several_steps_whose_rewards_are_summed() -> None:
    controller = Controller("pendulum-swingup", config=replace(BY_REWARD, action_repeat=5))
    task = TASKS["pendulum-swingup"]
    assert controller.plant.control_step == pytest.approx(5 * Plant.find(task).control_step)
    episode = run_episode(controller, 0, 0, num_steps=4)
    env = make_env(task)
    env.reset(seed=0, options={"state": episode.states[0]})
    for i, control in enumerate(episode.controls):
        steps = [env.step(control) for _ in range(5)]
        assert episode.rewards[i] == pytest.approx(sum(float(reward) for _, reward, *_ in steps))
        np.testing.assert_array_equal(steps[-1][4]["state"], episode.states[i + 1])
    with pytest.raises(UsageError, match="--action-repeat 7 must divide the 200 steps of pendulum-swingup"):
        Controller("pendulum-swingup", config=replace(BY_REWARD, action_repeat=7))


def test_in_a_gymnasium_environment_it_does_the_same(embedding: Embedding) -> None:
    controller = Controller("cartpole-swingup", embedding, ControlConfig(samples=16))
    episode = run_episode(controller, 0, 0, num_steps=8)
    env = make_env("cartpole-swingup")
    _, info = env.reset(seed=0, options={"state": episode.states[0]})
    controller.reset((0, 0, 1))
    for reward, state in zip(episode.rewards, episode.states[1:], strict=True):
        _, found, _, _, info = env.step(controller(info["state"]))
        assert found == reward
        np.testing.assert_array_equal(info["state"], state)


def test_what_was_planned_is_remembered() -> None:
    """Without noise, the next plan is the last one, moved by a step; it ends with its last value."""
    controller = Controller("pendulum", config=replace(BY_REWARD, knots=10, horizon_s=0.4))
    controller(HANGING)
    planned = controller._mean.copy()
    controller.config = replace(controller.config, noise=1e-9)
    controller(HANGING)
    np.testing.assert_allclose(controller._mean[:-1], planned[1:], atol=1e-6)
    np.testing.assert_allclose(controller._mean[-1], planned[-1], atol=1e-6)


def test_z_is_minimised(embedding: Embedding) -> None:
    """With a horizon of one step, the control leads as near to the goal in z as the best of a fine grid."""
    config = ControlConfig(METHODS["sampling"], horizon_s=0.04, samples=400, knots=1, effort_weight=0.0)
    controller = Controller("cartpole-swingup", embedding, replace(config, regulator=False))
    plant, state = controller.plant, np.array([0.0, 2.0, 0.0, 0.5])
    grid = np.linspace(-3.0, 3.0, 601)[:, None]
    simulator = plant.simulator(len(grid))
    simulator.reset(np.tile(state, (len(grid), 1)))
    simulator.step(grid, plant.task.frame_skip)
    best = grid[embedding.distance(simulator.states(), np.zeros(4)).argmin()]
    assert controller(state) == pytest.approx(best, abs=0.1)


@pytest.mark.slow
def test_an_episode_swings_the_pendulum_up_by_its_reward_and_counts_what_it_did() -> None:
    controller = Controller("pendulum-swingup", config=replace(BY_REWARD, horizon_s=0.8, regulator=True))
    episode = run_episode(controller, 0, 0, 100)
    assert episode.success and episode.arrival is not None
    assert episode.at_goal[episode.arrival :].all() and not episode.at_goal[episode.arrival - 1]
    assert len(episode.states) == 101 == len(episode.controls) + 1
    again = run_episode(controller, 0, 0, 100)
    np.testing.assert_array_equal(episode.states, again.states)


def test_rewards_are_those_of_the_environment() -> None:
    import gymnasium

    controller = Controller("pendulum-swingup", config=BY_REWARD)
    episode = run_episode(controller, 0, 0, 20)
    env = gymnasium.make("planspace/PendulumSwingUp-v0").unwrapped
    env.reset(options={"state": episode.states[0]})
    for control, reward in zip(episode.controls, episode.rewards, strict=True):
        assert env.step(control)[1] == pytest.approx(reward, abs=1e-5)


def test_a_name_of_a_task_and_a_problem_means_the_task() -> None:
    assert Plant.find("cartpole-swingup").task is TASKS["cartpole-swingup"]
    assert Plant.find("acrobot").task.problem_name == "acrobot"


def test_goals_can_be_drawn() -> None:
    problem = load_problem("reacher-random")
    plant = Plant.find(problem)
    target = plant.task.sample_starts(1, np.random.default_rng(0))[1][0]
    assert plant.goal(target).reached(target)


@pytest.mark.parametrize(
    ("problem", "config", "says"),
    [
        ("pendulum", ControlConfig(), "cost z needs an embedding"),
        ("pendulum", replace(BY_REWARD, horizon_s=0.01), "one control step of 0.04 s and at most 10,000"),
        ("reacher-trig", BY_REWARD, "draws a target that is not a state"),
        ("arm-kinematic", BY_REWARD, "is kinematic"),
        ("pendulun", BY_REWARD, "pendulum"),
    ],
)
def test_what_does_not_fit_is_refused(problem: str, config: ControlConfig, says: str) -> None:
    with pytest.raises(PlanspaceError, match=says):
        Controller(problem, config=config)


def test_the_cost_time_needs_a_time_head(embedding: Embedding) -> None:
    with pytest.raises(UsageError, match="planspace embed --time-head"):
        Controller("cartpole-swingup", embedding, ControlConfig(cost="time"))


def test_the_cost_time_is_the_time_to_the_goal(embedding: Embedding) -> None:
    rng = np.random.default_rng(0)
    width = embedding.inputs(np.zeros(4)).shape[-1]
    head = TimeHead([rng.standard_normal((8, width)).astype(np.float32)], [np.zeros(8, dtype=np.float32)])
    timed, plant = replace(embedding, time_head=head), Plant.find("cartpole-swingup")
    config = ControlConfig(cost="time", effort_weight=0.0, terminal_weight=0.0, cost_points=2)
    cost = make_cost(plant, config, np.empty(0), timed)
    states = rng.standard_normal((3, 5, 4))
    found = cost(states, np.zeros((3, 4, 1)))
    times = timed.time_to_go(states[:, [2, 4]], np.zeros(4)).mean(axis=1)
    np.testing.assert_allclose(found / found[0], times / times[0])


def test_an_embedding_of_other_joints_is_refused(embedding: Embedding) -> None:
    with pytest.raises(UsageError, match="'slider' is missing"):
        Controller("pendulum", embedding)
    degrees = replace(embedding, inputs=replace(embedding.inputs, units=("m", "deg", "m/s", "deg/s")))
    with pytest.raises(UsageError, match="reads 'hinge' in deg, but here it is in rad"):
        Controller("cartpole-swingup", degrees)


def test_a_control_without_limits_is_refused(tmp_path: Path) -> None:
    text = (ASSETS / "pendulum.xml").read_text()
    problem = load_problem("pendulum")
    unlimited = re.sub(r"ctrlrange=\"[^\"]*\"|ctrllimited=\"true\"", "", text)
    with pytest.raises(UsageError, match="has no limits"):
        Controller(replace(problem, model=unlimited), config=BY_REWARD)


def test_a_goal_far_from_the_demonstrations_is_reported(embedding: Embedding) -> None:
    problem = load_problem("cartpole-swingup")
    assert support_note(Plant.find(problem), ControlConfig(), embedding) is None
    far = _with_goal(problem, (0.9, 0.0, 20.0, 30.0))
    with pytest.warns(UserWarning, match=r"outside the region .* standard deviations"):
        Controller(far, embedding, ControlConfig(samples=8))


def _with_goal(problem: Problem, goal: tuple[float, ...]) -> Problem:
    return replace(problem, goal=replace(problem.goal, low=goal, high=goal), hold=False)


@pytest.mark.parametrize("state", [np.full(2, np.nan), np.array([np.inf, 0.0]), np.zeros(3)])
def test_a_state_that_is_none_is_refused(state: np.ndarray) -> None:
    controller = Controller("pendulum", config=BY_REWARD)
    with pytest.raises(UsageError, match=r"the state must be 2 finite numbers \(hinge, hingevel\), got"):
        controller(state)


def test_a_drawn_goal_must_be_given() -> None:
    controller = Controller("reacher-random", config=replace(BY_REWARD, cost="reward"))
    state = np.zeros(4)
    with pytest.raises(UsageError, match=r"goals of reacher-random are drawn.*reset\(target=...\)"):
        controller(state)
    for target in (np.full(4, np.nan), np.zeros(9)):
        with pytest.raises(UsageError, match="the target must be"):
            controller.reset(0, target)


def test_the_noise_is_divided_by_one_at_least() -> None:
    with pytest.raises(UsageError, match="`noise_spread` must be at least 1"):
        replace(BY_REWARD, noise_spread=0.5)


def test_a_quaternion_of_zero_is_refused() -> None:
    controller = Controller("quadrotor", config=BY_REWARD)
    with pytest.raises(UsageError, match="of the state is zero, which is no rotation"):
        controller(np.zeros(len(controller.plant.space.names)))
