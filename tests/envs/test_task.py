import gymnasium
import numpy as np
import pytest

import planspace
from planspace.envs.batch import TaskBatch
from planspace.errors import UsageError
from planspace.tasks.catalog import TASKS, find_task
from planspace.tasks.problem_file import load_problem
from planspace.tasks.reacher import fingertip
from planspace.tasks.task import Task

IDS = [task.env_id for task in TASKS.values()]


@pytest.mark.parametrize("env_id", IDS)
def test_the_spec_has_the_horizon(env_id: str) -> None:
    env = gymnasium.make(env_id)
    assert env.spec is not None and env.spec.max_episode_steps == env.unwrapped.task.horizon  # pyright: ignore


def test_gymnasium_imports_planspace_by_the_id() -> None:
    assert gymnasium.make("planspace:planspace/CartPole-v0").spec is not None


def test_reward_of_the_swing_up_by_hand() -> None:
    reward = TASKS["cartpole-swingup"].reward
    after = np.array([[0, 2 * np.pi + 0.05, 0, 0], [0, -3.0, 0, 0], [0, 0.3, 0, 0]])
    control = np.array([[0.0], [3.0], [-1.0]])
    # upright after one winding: -0.05 + 1; hanging at full thrust: -3 - 0.9; tilted: -0.3 - 0.1
    np.testing.assert_allclose(reward(after, after, control, np.empty((3, 0))), [0.95, -3.9, -0.4])


def test_the_reward_of_2020_by_hand() -> None:
    reward = TASKS["cartpole-swingup"].reward_2020
    assert reward is not None
    after = np.array([[0, 3.0, 0, 0], [0, -3.0, 0, 0], [0, 2 * np.pi - 0.5, 0, 0]])
    # no bonus on one half of the circle; on the other at -3 too, where the pole hangs; -0.5 seen the long way
    expected = [-3.0, -3.0 + 1 - 0.1 * 10**2, -0.5 + 1]
    np.testing.assert_allclose(reward(after, after, np.array([[0], [10], [0]]), np.empty((3, 0))), expected)


def test_the_reward_of_2020_comes_without_control_limits() -> None:
    states, rewards = [], []
    for force in (3.0, 6.0):
        for form in ("dense", "2020"):
            env = gymnasium.make("planspace/CartPoleSwingUp-v0", reward=form)
            assert env.action_space == gymnasium.make("planspace/CartPoleSwingUp-v0").action_space
            env.reset(seed=0, options={"state": [0.0, 1.0, 0.0, 0.0]})
            _, reward, _, _, info = env.step(np.array([force], np.float32))
            states.append(info["state"])
            rewards.append(float(reward))
    np.testing.assert_array_equal(states[0], states[1])
    np.testing.assert_array_equal(states[0], states[2])  # the dense reward clips it
    assert states[3][2] > 1.9 * states[0][2]
    assert rewards[0] == rewards[1] == rewards[2]
    assert rewards[3] - rewards[0] == pytest.approx(-0.1 * (36 - 9), abs=0.1)
    with pytest.raises(UsageError, match="unknown reward type of reacher-raw '2020'.*Known: dense, sparse"):
        gymnasium.make("planspace/ReacherRaw-v0", reward="2020")


def test_reward_of_the_reacher_by_hand() -> None:
    reward = TASKS["reacher-raw"].reward
    before = np.array([[0.0, np.pi / 2, 0.0, 0.0]])  # elbow at (0.1, 0), fingertip at (0.1, 0.11)
    np.testing.assert_allclose(fingertip(before), [[0.1, 0.11]], atol=1e-12)
    after, target = before + 1.0, np.array([[0.1, 0.0]])
    # from the pose before the step: -0.11 - 0.1 (1 + 0.25)
    np.testing.assert_allclose(reward(before, after, np.array([[1.0, 0.5]]), target), [-0.235])


def test_fingertip_equals_mujocos(rng: np.random.Generator) -> None:
    import mujoco

    model, space = TASKS["reacher-raw"].compile()
    data = mujoco.MjData(model)
    for state in rng.uniform(-3, 3, (10, 4)):
        space.write(state, data.qpos, data.qvel, data.act)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(fingertip(state[None])[0], data.body("fingertip").xpos[:2], atol=1e-12)


POSES = ["pendulum-swingup", "acrobot-swingup", "quadrotor-planar", "quadrotor", "arm"]


@pytest.mark.parametrize("name", POSES)
def test_a_pose_starts_and_ends_where_its_planning_problem_does(name: str, rng: np.random.Generator) -> None:
    task = TASKS[name]
    problem = load_problem(task.problem)
    assert task.joints == problem.joints
    assert (task.start_low, task.start_high) == (problem.start.low, problem.start.high)
    goal, none = np.array([problem.goal.low]), np.empty((1, 0))
    assert task.at_goal(goal, none).all()
    assert task.at_goal(task.sample_starts(50, rng)[0], np.empty((50, 0))).mean() < 0.1
    idle = np.zeros((1, len(task.compile()[0].actuator_ctrlrange)))
    model = task.compile()[0]
    hold = np.full_like(idle, -model.opt.gravity[2] * 0.5 / idle.size if "quadrotor" in name else 0.0)
    assert task.reward(goal, goal, hold, none) == pytest.approx(1.0)  # nothing is better
    assert task.reward(goal, goal, hold + 0.5, none) < 1.0


def test_a_pose_costs_its_weighted_distance_by_hand() -> None:
    off = np.array([[0.3, -0.4, 2 * np.pi + 0.5, 9.0, 9.0, 9.0], [30.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    hold = np.full((2, 2), 2.4525)
    reward = TASKS["quadrotor-planar"].reward(off, off, hold, np.empty((2, 0)))
    np.testing.assert_allclose(reward, [-(0.3 + 0.4 + 0.2 * 0.5), -5.0])  # velocities are free; far is far
    turned = np.array([[0, 0, 0, np.cos(0.3), np.sin(0.3), 0, 0, *(0,) * 6]], dtype=float)
    reward = TASKS["quadrotor"].reward(turned, turned, np.full((1, 4), 1.22625), np.empty((1, 0)))
    np.testing.assert_allclose(reward, [-0.2 * 0.6])


def test_starts_of_a_rotation_have_length_one(rng: np.random.Generator) -> None:
    states, _ = TASKS["quadrotor"].sample_starts(20, rng)
    np.testing.assert_allclose(np.linalg.norm(states[:, 3:7], axis=1), 1.0)


@pytest.mark.parametrize("env_id", IDS)
def test_sparse_reward_is_paid_only_at_the_goal(env_id: str) -> None:
    env = gymnasium.make(env_id, reward="sparse")
    env.reset(seed=0)
    task = env.unwrapped.task  # pyright: ignore
    rewards = []
    for _ in range(20):
        _, reward, _, _, info = env.step(np.zeros(env.action_space.shape, np.float32))  # pyright: ignore
        targets = env.unwrapped._batch.targets  # pyright: ignore
        assert reward == float(task.at_goal(info["state"][None], targets)[0])
        rewards.append(reward)
    assert set(rewards) <= {0.0, 1.0}


def test_ten_thousand_random_steps_stay_in_bounds() -> None:
    for env_id in IDS:
        env = gymnasium.make_vec(env_id, num_envs=100, vectorization_mode="vector_entry_point")
        env.reset(seed=0)
        env.action_space.seed(0)
        for _ in range(100):
            obs, reward, _, _, info = env.step(env.action_space.sample())
            assert obs in env.observation_space
            assert np.isfinite(obs).all() and np.isfinite(reward).all()
        assert not info["diverged"].any()


@pytest.mark.parametrize("env_id", IDS)
def test_physics_is_a_plain_loop_of_mj_step(env_id: str) -> None:
    import mujoco

    env = gymnasium.make(env_id)
    task = env.unwrapped.task  # pyright: ignore
    model, space = task.compile()
    data = mujoco.MjData(model)
    env.action_space.seed(0)
    _, info = env.reset(seed=0)
    space.write(info["state"], data.qpos, data.qvel, data.act)
    for _ in range(60):
        action = env.action_space.sample()
        _, _, terminated, _, info = env.step(action)
        data.ctrl[:] = action
        for _ in range(task.frame_skip):
            mujoco.mj_step(model, data)
        np.testing.assert_array_equal(info["state"], space.read(data.qpos, data.qvel, data.act))
        if terminated:
            break


def test_the_reward_charges_the_clipped_control() -> None:
    batch = TaskBatch(TASKS["cartpole-swingup"], 2, threads=1)
    batch.reset(np.zeros((2, 4)), np.empty((2, 0)))
    reward, _, _ = batch.step(np.array([[3.0], [1e6]]))
    assert reward[0] == reward[1]
    np.testing.assert_array_equal(batch.states[0], batch.states[1])


def test_balance_ends_when_the_pole_falls() -> None:
    env = gymnasium.make("planspace/CartPole-v0")
    env.reset(seed=0)
    for _ in range(100):
        _, reward, terminated, truncated, info = env.step(np.array([3.0], dtype=np.float32))
        assert reward == 1.0
        if terminated:
            break
    assert terminated and not truncated
    assert abs(info["state"][1]) > 0.2


CHECK_FIGURES = {"idle": (-600.0, 23.0), "noise": (-567.0, 25.0)}
"""Mean and standard deviation of the swing-up's return over starts."""


@pytest.mark.parametrize("kind", CHECK_FIGURES)
def test_returns_of_idle_and_random_policies(kind: str, rng: np.random.Generator) -> None:
    task, num = TASKS["cartpole-swingup"], 400
    batch = TaskBatch(task, num)
    batch.reset(*task.sample_starts(num, rng))
    total = np.zeros(num)
    for _ in range(task.horizon):
        actions = rng.standard_normal((num, 1)) if kind == "noise" else np.zeros((num, 1))
        total += batch.step(actions)[0]
    mean, deviation = CHECK_FIGURES[kind]
    assert abs(total.mean() - mean) < 8
    assert abs(total.std() - deviation) < 5


def test_divergence_truncates_and_is_recorded() -> None:
    env = gymnasium.make("planspace/CartPoleSwingUp-v0").unwrapped
    env._batch.simulator.model.opt.timestep = 0.02  # pyright: ignore
    env.reset(seed=0, options={"state": [0.0, 1.0, 1e9, 1e9]})
    for _ in range(5):
        obs, reward, _, truncated, info = env.step(np.array([0.0], dtype=np.float32))
        if truncated:
            break
    assert truncated and info["diverged"] and reward == 0.0
    assert np.isfinite(obs).all()


def test_starts_from_a_given_state_of_the_right_size() -> None:
    env = gymnasium.make("planspace/CartPoleSwingUp-v0", obs="trig")
    obs, info = env.reset(options={"state": [0.1, 0.5, 0.0, 0.0]})
    np.testing.assert_allclose(obs, [0.1, 0.5, 0, 0, np.sin(0.5), np.cos(0.5)], atol=1e-6)
    np.testing.assert_array_equal(info["state"], [0.1, 0.5, 0.0, 0.0])
    with pytest.raises(UsageError, match=r"a state has 4 numbers .*, got shape \(2,\)"):
        env.reset(options={"state": [0.0, 0.0]})
    with pytest.raises(UsageError, match="a start state must be numbers, got 'upright'"):
        env.reset(options={"state": "upright"})


def test_a_given_quaternion_is_normalised() -> None:
    env = gymnasium.make("planspace/Quadrotor-v0")
    state = np.zeros(13)
    with pytest.raises(UsageError, match=r"a quaternion \(body_qw, .* cannot be 0"):
        env.reset(options={"state": state})
    state[3] = 5.0
    _, info = env.reset(options={"state": state})
    assert info["state"][3] == 1.0


def test_extreme_actions_are_refused_or_end_the_episode() -> None:
    env = gymnasium.make("planspace/CartPoleSwingUp-v0", reward="2020")
    env.reset(seed=0)
    with pytest.raises(UsageError, match="an action must be finite numbers"):
        env.step(np.array([np.inf], np.float32))
    _, _, _, truncated, info = env.step(np.array([1e30], np.float32))
    assert truncated and info["diverged"]


def test_tasks_are_found_by_name_and_suggest_the_nearest() -> None:
    assert isinstance(find_task("cartpole"), Task)
    with pytest.raises(UsageError, match="unknown task 'reachr'. Did you mean 'reacher"):
        find_task("reachr")


def test_the_package_says_its_version() -> None:
    assert planspace.__version__
