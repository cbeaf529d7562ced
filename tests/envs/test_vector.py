import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from planspace.envs.vector import TaskVectorEnv
from planspace.errors import UsageError
from planspace.tasks.catalog import TASKS

IDS = [task.env_id for task in TASKS.values()]
BALANCE, SWING_UP = "planspace/CartPole-v0", "planspace/CartPoleSwingUp-v0"
MODES = list(AutoresetMode)


def make(env_id: str, num_envs: int = 5, **kwargs: Any) -> TaskVectorEnv:
    env = gymnasium.make_vec(
        env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", **kwargs
    ).unwrapped
    assert isinstance(env, TaskVectorEnv)
    return env


def one_by_one(env_id: str, num_envs: int, mode: AutoresetMode, **kwargs: Any) -> SyncVectorEnv:
    """Gymnasium's own: the single environments, in the order of Gymnasium's wrappers."""
    return SyncVectorEnv([lambda: gymnasium.make(env_id, **kwargs)] * num_envs, autoreset_mode=mode)


def same(a: Any, b: Any) -> bool:
    """Whether two infos, or parts of them, hold the same."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if a.dtype == object:
        return all(x is y is None or np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    return np.array_equal(a, b)


def reset_ended(env: Any, ended: np.ndarray) -> None:
    env.reset(options={"reset_mask": ended})


CASES = [
    pytest.param(
        env_id,
        mode,
        marks=() if env_id == BALANCE or mode == AutoresetMode.NEXT_STEP else pytest.mark.slow,
        id=f"{env_id}-{mode.value}",
    )
    for env_id in IDS
    for mode in MODES
]


@pytest.mark.parametrize(("env_id", "mode"), CASES)
def test_equals_single_environments_bit_for_bit(env_id: str, mode: AutoresetMode) -> None:
    ours = make(env_id, autoreset_mode=mode, max_episode_steps=30, threads=2)
    theirs = one_by_one(env_id, 5, mode, max_episode_steps=30)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    (obs, info), (expected, expected_info) = ours.reset(seed=11), theirs.reset(seed=11)
    assert np.array_equal(obs, expected) and same(info, expected_info)
    ours.action_space.seed(0)
    ends = 0
    for _ in range(70):
        actions = ours.action_space.sample()
        got, wanted = ours.step(actions), theirs.step(actions)
        for a, b in zip(got[:4], wanted[:4], strict=True):
            assert a.dtype == b.dtype and np.array_equal(a, b)
        assert same(got[4], wanted[4])
        ended = got[2] | got[3]
        ends += ended.sum()
        if mode == AutoresetMode.DISABLED and ended.any():
            reset_ended(ours, ended)
            reset_ended(theirs, ended)
    assert ends >= 10


@pytest.mark.parametrize("obs", ["raw", "wrapped", "trig"])
def test_every_observation_type(obs: str) -> None:
    ours, theirs = make(SWING_UP, obs=obs), one_by_one(SWING_UP, 5, MODES[0], obs=obs)
    state = {"state": [0.1, 7.0, 0.2, 0.3]}
    assert np.array_equal(ours.reset(options=dict(state))[0], theirs.reset(options=dict(state))[0])
    seen = dict(zip(ours.obs_fields, ours.reset(options=state)[0][0], strict=True))
    assert seen["hinge"] == pytest.approx(7.0 - 2 * np.pi if obs == "wrapped" else 7.0)
    assert ("sin_hinge" in seen) == (obs == "trig")
    assert ours.obs_fields["hinge"] == ours.state_fields["hinge"] == "rad"


def test_threads_change_nothing() -> None:
    runs = []
    for threads in (1, 2, 3):
        env = make(SWING_UP, num_envs=16, threads=threads)
        env.reset(seed=0)
        env.action_space.seed(0)
        for _ in range(50):
            env.step(env.action_space.sample())
        runs.append(env.states)
    assert np.array_equal(runs[0], runs[1]) and np.array_equal(runs[0], runs[2])


def test_an_episode_does_not_depend_on_other_environments() -> None:
    many, few = make(BALANCE, num_envs=8), make(BALANCE, num_envs=3)
    many.reset(seed=5)
    few.reset(seed=5)
    for _ in range(60):  # balancing ends early, so that streams are drawn from again
        actions = np.full((8, 1), 1.0, np.float32)
        many.step(actions)
        few.step(actions[:3])
    assert np.array_equal(many.states[:3], few.states)


def test_starts_from_given_states_one_for_all_or_one_for_each() -> None:
    env = make(SWING_UP, num_envs=3)
    _, info = env.reset(options={"state": [0.1, 0.5, 0.0, 0.0]})
    assert np.array_equal(info["state"], [[0.1, 0.5, 0.0, 0.0]] * 3)
    each = np.arange(12.0).reshape(3, 4) / 10
    _, info = env.reset(options={"state": each, "reset_mask": np.array([True, False, True])})
    assert np.array_equal(info["state"][[0, 2]], each[[0, 2]])
    assert info["_state"].tolist() == [True, False, True]
    assert np.array_equal(env.states[1], [0.1, 0.5, 0.0, 0.0])


def test_a_seed_of_none_continues_the_stream() -> None:
    env = make(SWING_UP, num_envs=2)
    env.reset(seed=[3, 4])
    second = env.reset()[0]
    env.reset(seed=[3, 4])
    again = env.reset(seed=[3, None])[0]
    assert not np.array_equal(again[0], second[0]) and np.array_equal(again[1], second[1])


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
def test_divergence_truncates_only_its_own_episode(mode: AutoresetMode) -> None:
    env = make(SWING_UP, num_envs=3, autoreset_mode=mode)
    states = np.zeros((3, 4))
    states[1] = [0.0, 1.0, 1e9, 1e9]
    env.reset(seed=0, options={"state": states})
    for _ in range(5):
        obs, rewards, _, truncated, info = env.step(np.zeros((3, 1), np.float32))
        if truncated.any():
            break
    assert truncated.tolist() == [False, True, False] and rewards[1] == 0.0
    assert np.isfinite(obs).all()
    told = info["final_info"] if mode == AutoresetMode.SAME_STEP else info
    assert told["diverged"].tolist() == [False, True, False] and told["_diverged"][1]


def test_specs_pickles_and_copies_make_the_same_environment() -> None:
    env = make("planspace/ReacherRaw-v0", num_envs=3, obs="trig")
    assert env.spec is not None
    again = gymnasium.make_vec(type(env.spec).from_json(env.spec.to_json()))
    for other in (again, pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
        assert other.num_envs == 3
        assert np.array_equal(other.reset(seed=1)[0], env.reset(seed=1)[0])


def test_misfits_are_refused() -> None:
    env = make(SWING_UP, num_envs=2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((2, 1)))
    env.reset(seed=3)
    with pytest.raises(UsageError, match=r"an action must have shape \(2, 1\), got \(2,\)"):
        env.step(np.zeros(2))
    with pytest.raises(UsageError, match="an action must be finite numbers"):
        env.step(np.array([[0.0], [np.nan]]))
    with pytest.raises(UsageError, match="expected 2 seeds, one for each environment, got 3"):
        env.reset(seed=[1, 2, 3])
    with pytest.raises(UsageError, match="a state has 4 numbers"):
        env.reset(options={"state": np.zeros((3, 4))})
    with pytest.raises(UsageError, match="must be finite"):
        env.reset(options={"state": [0.0, np.inf, 0.0, 0.0]})
    with pytest.raises(UsageError, match="reset_mask must have 2 truth values"):
        env.reset(options={"reset_mask": np.zeros(2, dtype=bool)})
    disabled = make(SWING_UP, num_envs=2, autoreset_mode="Disabled", max_episode_steps=1)
    disabled.reset(seed=0)
    disabled.step(np.zeros((2, 1)))
    with pytest.raises(UsageError, match=r"episodes \[0, 1\] have ended: reset them first"):
        disabled.step(np.zeros((2, 1)))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"obs": "cooked"}, "unknown observation type 'cooked'"),
        ({"render_mode": "human"}, "unknown render mode 'human'"),
        ({"autoreset_mode": "Never"}, "unknown autoreset mode 'Never'"),
        ({"num_envs": 0}, "`num_envs` must be a whole number of at least 1"),
    ],
)
def test_arguments_are_checked_at_construction(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        TaskVectorEnv("cartpole", **kwargs)


def test_minus_one_step_never_truncates() -> None:
    env = make(SWING_UP, num_envs=2, max_episode_steps=-1)
    env.reset(seed=0)
    for _ in range(205):
        assert not env.step(np.zeros((2, 1)))[3].any()
    for wrong in (0, -2):
        with pytest.raises(UsageError, match="max_episode_steps must be 1 or more, or -1 for no limit"):
            make(SWING_UP, max_episode_steps=wrong)
