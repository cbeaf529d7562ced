from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import FlattenObservation

from planspace import wrap
from planspace.envs.wrappers import (
    PlanSpaceObservation,
    PlanSpaceShaping,
    PlanSpaceVectorObservation,
    PlanSpaceVectorShaping,
)
from planspace.errors import UsageError

from .goal_env import COLUMNS, GOAL, point_embedding, point_env

E = point_embedding()
Z_KEYS = {"z", "z_achieved_goal", "z_desired_goal", "z_difference"}


def at_rest(goal: np.ndarray) -> np.ndarray:
    """The state of a goal: its position, without velocity."""
    return np.concatenate([goal, np.zeros_like(goal)], axis=-1)


@pytest.mark.parametrize("mode", ["augment", "dict"])
def test_z_is_an_entry_of_a_dictionary(mode: str) -> None:
    env = wrap(point_env(), E, mode, COLUMNS)
    env.reset(seed=0)
    obs, *_ = env.step(np.ones(2, np.float32))
    assert set(obs) == {"observation", "achieved_goal", "desired_goal", "z"}
    assert obs in env.observation_space
    assert obs["z"].dtype == np.float32
    np.testing.assert_allclose(obs["z"], E.encode(obs["observation"]), atol=1e-6)


def test_z_of_both_goals_and_their_difference() -> None:
    env = wrap(point_env(), E, columns=COLUMNS, goal=GOAL)
    obs, _ = env.reset(seed=0)
    for _ in range(3):
        assert set(obs) == {"observation", "achieved_goal", "desired_goal", *Z_KEYS}
        assert obs in env.observation_space
        for name in ("achieved_goal", "desired_goal"):
            np.testing.assert_allclose(obs[f"z_{name}"], E.encode(at_rest(obs[name])), atol=1e-6)
        np.testing.assert_array_equal(obs["z_difference"], obs["z_desired_goal"] - obs["z_achieved_goal"])
        obs, *_ = env.step(np.ones(2, np.float32))


def test_replace_shows_only_z() -> None:
    plain = wrap(point_env(), E, "replace", COLUMNS)
    assert plain.reset(seed=0)[0] in plain.observation_space and plain.observation_space.shape == (3,)
    with_goals = wrap(point_env(), E, "replace", COLUMNS, GOAL)
    assert set(with_goals.reset(seed=0)[0]) == Z_KEYS == set(with_goals.observation_space.spaces)


def test_the_spec_of_a_goal_environment_survives_json(tmp_path) -> None:
    from .goal_env import PointEnv

    gymnasium.register("Point-v0", PointEnv, max_episode_steps=10)
    try:
        E.save(tmp_path / "e")
        env = wrap(gymnasium.make("Point-v0"), tmp_path / "e", columns=COLUMNS, goal=GOAL)
        assert env.spec is not None
        spec = env.spec.additional_wrappers[-1]
        assert spec.kwargs["goal"] == GOAL and spec.kwargs["columns"] == COLUMNS
    finally:
        del gymnasium.registry["Point-v0"]


@pytest.mark.parametrize("autoreset", list(AutoresetMode), ids=lambda mode: mode.value)
def test_the_vector_wrappers_equal_the_single_ones(autoreset: AutoresetMode) -> None:
    def many(wrapper: Any) -> SyncVectorEnv:
        return SyncVectorEnv([lambda: wrapper(point_env(5))] * 3, autoreset_mode=autoreset)

    def shaped(env: Any) -> Any:
        return PlanSpaceShaping(env, E, GOAL, columns=COLUMNS)

    def shown(env: Any) -> Any:
        return PlanSpaceObservation(env, E, columns=COLUMNS, goal=GOAL)

    ours = PlanSpaceVectorObservation(
        PlanSpaceVectorShaping(many(lambda env: env), E, GOAL, columns=COLUMNS), E, "augment", COLUMNS, GOAL
    )
    theirs = many(lambda env: shown(shaped(env)))
    assert ours.observation_space == theirs.observation_space
    alike(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
    ours.action_space.seed(0)
    num_last = 0
    for _ in range(17):
        actions = ours.action_space.sample()
        got, wanted = ours.step(actions), theirs.step(actions)
        alike(got[0], wanted[0])
        np.testing.assert_allclose(got[1], wanted[1], atol=1e-5)
        for a, b in zip(got[4].get("final_obs", []), wanted[4].get("final_obs", []), strict=True):
            assert (a is None) == (b is None)
            if a is not None:
                alike(a, b)
                num_last += 1
        if autoreset == AutoresetMode.DISABLED and (got[2] | got[3]).any():
            for env in (ours, theirs):
                env.reset(options={"reset_mask": got[2] | got[3]})
    assert (num_last > 0) == (autoreset == AutoresetMode.SAME_STEP)


def alike(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> None:
    assert a.keys() == b.keys()
    for key in a:
        assert a[key].dtype == b[key].dtype
        np.testing.assert_allclose(a[key], b[key], atol=1e-5)


def test_shaping_at_relabelling_is_that_of_acting() -> None:
    """`compute_reward` gives the reward of `step`, and for another goal that of a run with that goal."""
    other = np.array([0.4, -0.9])
    env, alternative = (PlanSpaceShaping(point_env(), E, GOAL, 2.0, 0.9, COLUMNS) for _ in range(2))
    for e in (env, alternative):
        e.reset(seed=0)
    alternative.unwrapped.goal[:] = other  # pyright: ignore
    alternative.env.reset = lambda **_: (alternative.unwrapped.observe(), {})  # type: ignore[method-assign]
    alternative.reset()
    achieved, desired, infos, rewards, wanted = [], [], [], [], []
    rng = np.random.default_rng(0)
    for _ in range(10):
        action = rng.uniform(-1, 1, 2).astype(np.float32)
        obs, reward, terminated, truncated, info = env.step(action)
        single = env.compute_reward(obs["achieved_goal"], obs["desired_goal"], info)
        assert single == pytest.approx(reward, abs=1e-6)
        achieved.append(obs["achieved_goal"])
        desired.append(obs["desired_goal"])
        infos.append(info)
        rewards.append(reward)
        wanted.append(alternative.step(action)[1])
        if terminated or truncated:
            break
    stacked = np.stack(achieved)
    np.testing.assert_allclose(env.compute_reward(stacked, np.stack(desired), infos), rewards, atol=1e-6)
    relabelled = np.tile(other, (len(achieved), 1))
    np.testing.assert_allclose(env.compute_reward(stacked, relabelled, np.array(infos)), wanted, atol=1e-6)


def test_the_potential_is_0_after_a_terminated_step_at_relabelling_too() -> None:
    env = PlanSpaceShaping(point_env(50), E, GOAL, columns=COLUMNS)
    env.reset(seed=0)
    for _ in range(50):
        obs, reward, terminated, _, info = env.step(np.ones(2, np.float32))
        if terminated:
            break
    assert terminated and np.isnan(info["shaping_z"][1]).all()
    assert env.compute_reward(obs["achieved_goal"], obs["desired_goal"], info) == pytest.approx(reward)


def test_shaping_to_a_fixed_goal_is_kept_at_relabelling() -> None:
    env = PlanSpaceShaping(point_env(), E, [0.0, 0.0, 0.0, 0.0], columns=COLUMNS)
    obs, _ = env.reset(seed=0)
    obs, _, _, _, info = env.step(np.ones(2, np.float32))
    reached = env.compute_reward(obs["achieved_goal"], obs["achieved_goal"], info)
    assert reached == pytest.approx(info["shaping"])


def test_a_relabelled_step_without_its_info_is_refused() -> None:
    env = PlanSpaceShaping(point_env(), E, GOAL, columns=COLUMNS)
    goals = np.zeros((2, 2))
    with pytest.raises(UsageError, match=r"needs info\['shaping_z'\].*got an info with no entries: use.*Her"):
        env.compute_reward(goals, goals, [{}, {}])
    current = PlanSpaceShaping(point_env(), E, {**GOAL, "vx": "observation[2]"}, columns=COLUMNS)
    current.reset(seed=0)
    obs, _, _, _, info = current.step(np.ones(2, np.float32))
    with pytest.raises(UsageError, match="read from desired_goal and from observation"):
        current.compute_reward(obs["achieved_goal"], obs["desired_goal"], info)


def test_stale_z_of_a_relabelled_goal_is_reported_once() -> None:
    env = wrap(point_env(), E, columns=COLUMNS, goal=GOAL)
    goals = np.zeros((2, 2))
    with pytest.warns(UserWarning, match="z_desired_goal and z_difference are not: use planspace.envs.her"):
        env.compute_reward(goals, goals, [{}, {}])
    env.compute_reward(goals, goals, [{}, {}])
    told = wrap(point_env(), E, columns=COLUMNS, goal=GOAL)
    obs, _ = told.reset(seed=0)
    (view,) = told.recompute_goals()
    np.testing.assert_array_equal(view(obs)["z_desired_goal"], obs["z_desired_goal"])
    np.testing.assert_array_equal(told.compute_reward(goals, goals, [{}, {}]), [0.0, 0.0])
    assert wrap(point_env(), E, columns=COLUMNS).recompute_goals() == []


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ({"x": 0.0, "y": 0.0, "vx": 0.0, "vy": 0.0}, "does not read desired_goal: give places such as"),
        ({"x": "desired_goal[0]"}, "'y' is missing"),
        ({**GOAL, "x": "desired_goal[2]"}, r"'desired_goal' has 2 numbers; write 'desired_goal\[0\]' to"),
        ({**GOAL, "x": "goal[0]"}, "no key 'goal'; its keys are achieved_goal, desired_goal, observation"),
        ({**GOAL, "vx": np.nan}, "the goal must be a state of 4 finite numbers"),
        ("desired_goal", "the goal must be a state of 4 finite numbers"),
    ],
)
def test_goals_that_cannot_be_read_are_refused(goal: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        wrap(point_env(), E, columns=COLUMNS, goal=goal)


def test_goals_need_a_goal_environment() -> None:
    flat = FlattenObservation(point_env())
    with pytest.raises(UsageError, match="z of goals needs a Dict observation with the keys achieved_goal"):
        wrap(flat, E, columns=COLUMNS, goal=GOAL)


def test_two_embeddings_have_two_entries() -> None:
    other = point_embedding(1)
    once = wrap(point_env(), E, columns=COLUMNS, goal=GOAL)
    with pytest.raises(UsageError, match="already has an entry 'z': give this z another name with `key`"):
        wrap(once, other, columns=COLUMNS)
    twice = wrap(once, other, columns=COLUMNS, goal=GOAL, key="w")
    obs, _ = twice.reset(seed=0)
    assert obs in twice.observation_space
    np.testing.assert_allclose(obs["w"], other.encode(obs["observation"]), atol=1e-6)
    goal = at_rest(obs["desired_goal"])
    np.testing.assert_allclose(obs["w_desired_goal"], other.encode(goal), atol=1e-6)
    np.testing.assert_allclose(obs["z_desired_goal"], E.encode(goal), atol=1e-6)
    for view in twice.recompute_goals():
        np.testing.assert_array_equal(view(obs)[view.names[2]], obs[view.names[2]])
    assert len(twice.recompute_goals()) == 2
