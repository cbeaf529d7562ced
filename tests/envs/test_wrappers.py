import copy
import inspect
import json
import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import RescaleObservation

from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.envs.wrappers import (
    PlanSpaceObservation,
    PlanSpaceShaping,
    PlanSpaceVectorObservation,
    PlanSpaceVectorShaping,
)
from planspace.errors import PlanspaceError, UsageError

STATE = (0, 1, 2, 3)
GOAL = {"slider": 0.0, "hinge": 0.0, "slidervel": 0.0, "hingevel": 0.0}
MODES = list(AutoresetMode)


def swing_up(**kwargs: Any) -> gymnasium.Env:
    return gymnasium.make("planspace/CartPoleSwingUp-v0", **kwargs)


def many(mode: AutoresetMode = AutoresetMode.NEXT_STEP, steps: int = 20) -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec(
        "planspace/CartPole-v0",
        num_envs=4,
        vectorization_mode="vector_entry_point",
        autoreset_mode=mode,
        max_episode_steps=steps,
    )


def one_by_one(wrap: Any, mode: AutoresetMode, steps: int = 20) -> SyncVectorEnv:
    """The single wrapper around each single environment."""
    return SyncVectorEnv(
        [lambda: wrap(gymnasium.make("planspace/CartPole-v0", max_episode_steps=steps))] * 4,
        autoreset_mode=mode,
    )


@pytest.mark.parametrize("columns", [None, STATE])
def test_augment_appends_the_mean(
    embedding_folder: Path, embedding: Embedding, columns: tuple[int, ...] | None
) -> None:
    env = PlanSpaceObservation(swing_up(), embedding_folder, columns=columns)
    obs, info = env.reset(seed=0)
    for _ in range(3):
        np.testing.assert_allclose(obs, np.append(info["state"], embedding.encode(info["state"])), atol=1e-5)
        assert obs in env.observation_space
        obs, _, _, _, info = env.step(env.action_space.sample())


def test_replace_returns_only_z(embedding_folder: Path, embedding: Embedding) -> None:
    env = PlanSpaceObservation(swing_up(), embedding_folder, mode="replace")
    obs, info = env.reset(seed=0)
    np.testing.assert_allclose(obs, embedding.encode(info["state"]), atol=1e-6)
    assert env.observation_space.shape == (3,)


def test_dict_returns_both(embedding_folder: Path, embedding: Embedding) -> None:
    env = PlanSpaceObservation(swing_up(), embedding_folder, mode="dict")
    obs, info = env.reset(seed=0)
    assert obs in env.observation_space
    np.testing.assert_array_equal(obs["observation"], info["state"].astype(np.float32))
    np.testing.assert_allclose(obs["z"], embedding.encode(info["state"]), atol=1e-6)


@pytest.mark.parametrize("env_id", ["InvertedPendulum-v5", "InvertedDoublePendulum-v5"])
def test_joints_of_a_mujoco_environment_are_read_by_name(env_id: str, tmp_path: Path) -> None:
    names = ("hingevel", "slider") if env_id == "InvertedPendulum-v5" else ("hinge2", "slidervel")
    inputs = Inputs.fit(np.eye(2), names, ("", ""), (), "raw")
    encoder, decoder = ([np.eye(4)[:, :2]], [np.zeros(4)]), ([np.eye(4)[:, :2]], [np.zeros(4)])
    Embedding(inputs, encoder, decoder, 0.0).save(tmp_path / "e")
    env = PlanSpaceObservation(gymnasium.make(env_id), tmp_path / "e")
    env.reset(seed=0)
    obs, *_ = env.step(env.action_space.sample())
    data = env.unwrapped.data  # pyright: ignore
    column = {"hinge2": 2, "slider": 0}
    wanted = [
        data.qvel[{"hingevel": 1, "slidervel": 0}[n]] if n.endswith("vel") else data.qpos[column[n]]
        for n in names
    ]
    np.testing.assert_allclose(obs[-2:], wanted)
    assert obs.dtype == env.observation_space.dtype == np.float64  # as the environment has it
    assert obs in env.observation_space


def test_the_spec_survives_json_with_every_argument(embedding_folder: Path) -> None:
    env = PlanSpaceObservation(swing_up(), embedding_folder, mode="replace", columns=STATE)
    recorded = set(env._saved_kwargs)
    assert recorded == set(inspect.signature(PlanSpaceObservation).parameters) - {"env"}
    assert env.spec is not None
    again = gymnasium.make(type(env.spec).from_json(env.spec.to_json()))
    np.testing.assert_array_equal(again.reset(seed=3)[0], env.reset(seed=3)[0])


def test_the_spec_of_shaping_survives_json_too(embedding_folder: Path) -> None:
    env = PlanSpaceShaping(swing_up(), embedding_folder, goal=GOAL, scale=2.0)
    assert set(env._saved_kwargs) == set(inspect.signature(PlanSpaceShaping).parameters) - {"env"}
    assert env.spec is not None
    again = gymnasium.make(type(env.spec).from_json(env.spec.to_json()))
    action = np.ones(1, np.float32)
    for other in (again, pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
        other.reset(seed=3)
        env.reset(seed=3)
        assert other.step(action)[1] == env.step(action)[1]


@pytest.mark.parametrize("columns", [None, STATE])
@pytest.mark.parametrize("mode", ["augment", "replace", "dict"])
@pytest.mark.parametrize("autoreset", MODES, ids=lambda mode: mode.value)
def test_the_vector_wrapper_equals_the_single_one(
    embedding_folder: Path, columns: tuple[int, ...] | None, mode: str, autoreset: AutoresetMode
) -> None:
    def wrap(env: gymnasium.Env) -> gymnasium.Env:
        return PlanSpaceObservation(env, embedding_folder, mode, columns)

    ours = PlanSpaceVectorObservation(many(autoreset), embedding_folder, mode, columns)
    theirs = one_by_one(wrap, autoreset)
    assert ours.observation_space == theirs.observation_space
    alike(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
    ours.action_space.seed(0)
    for _ in range(45):
        actions = ours.action_space.sample()
        got, wanted = ours.step(actions), theirs.step(actions)
        alike(got[0], wanted[0])
        assert ("final_obs" in got[4]) == ("final_obs" in wanted[4])
        for a, b in zip(got[4].get("final_obs", []), wanted[4].get("final_obs", []), strict=True):
            assert (a is None) == (b is None)
            if a is not None:
                alike(a, b)
        ended = got[2] | got[3]
        if autoreset == AutoresetMode.DISABLED and ended.any():
            alike(*(env.reset(options={"reset_mask": ended})[0] for env in (ours, theirs)))


def alike(a: Any, b: Any) -> None:
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            alike(a[key], b[key])
    else:
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, atol=1e-5)  # one product of many rows rounds otherwise


def test_the_vector_wrapper_works_on_sync_vector_env(embedding_folder: Path, embedding: Embedding) -> None:
    plain = SyncVectorEnv([swing_up] * 3)
    env = PlanSpaceVectorObservation(plain, embedding_folder)
    obs, info = env.reset(seed=0)
    np.testing.assert_allclose(obs[:, 4:], embedding.encode(info["state"]), atol=1e-5)
    foreign = SyncVectorEnv([lambda: gymnasium.make("Pendulum-v1")] * 2)
    with pytest.raises(UsageError, match="have no `state_names`.*Give columns"):
        PlanSpaceVectorObservation(foreign, embedding_folder)


def test_vector_wrappers_record_their_arguments_and_can_be_copied(embedding_folder: Path) -> None:
    shown = PlanSpaceVectorObservation(many(), embedding_folder, mode="replace")
    shaped = PlanSpaceVectorShaping(many(), embedding_folder, GOAL, scale=2.0)
    for env in (shown, shaped):
        assert set(env._saved_kwargs) == set(inspect.signature(type(env)).parameters) - {"env"}
        json.dumps(env._saved_kwargs)
        wanted = env.reset(seed=3)[0], env.step(np.ones((4, 1), np.float32))[1]
        for other in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
            np.testing.assert_array_equal(other.reset(seed=3)[0], wanted[0])
            np.testing.assert_array_equal(other.step(np.ones((4, 1), np.float32))[1], wanted[1])


def test_a_missing_state_in_info_is_reported(embedding_folder: Path) -> None:
    class Silent(gymnasium.Wrapper[Any, Any, Any, Any]):
        def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
            return self.env.reset(**kwargs)[0], {}

    env = PlanSpaceVectorObservation(SyncVectorEnv([lambda: Silent(swing_up())] * 2), embedding_folder)
    with pytest.raises(UsageError, match=r'their info has no "state": add it in reset and step'):
        env.reset()


def test_shaping_by_hand(embedding_folder: Path, embedding: Embedding) -> None:
    plain = swing_up(max_episode_steps=3)
    env = PlanSpaceShaping(swing_up(max_episode_steps=3), embedding_folder, GOAL, scale=2.0, discount=0.9)
    action = np.ones(1, np.float32)
    plain.reset(seed=0)
    before = env.reset(seed=0)[1]["state"]
    for step in range(3):
        _, reward, terminated, truncated, info = env.step(action)
        near, far = (-2.0 * embedding.distance(x, np.zeros(4)) for x in (info["state"], before))
        assert info["shaping"] == pytest.approx(0.9 * near - far, abs=1e-6)
        assert reward == pytest.approx(float(plain.step(action)[1]) + info["shaping"])
        assert not terminated and truncated == (step == 2)  # cut off, where the potential still counts
        before = info["state"]


def test_shaping_sums_to_the_potential_of_the_start(embedding_folder: Path, embedding: Embedding) -> None:
    env = PlanSpaceShaping(gymnasium.make("planspace/CartPole-v0"), embedding_folder, GOAL, discount=0.9)
    start = env.reset(seed=0)[1]["state"]
    total, terminated = 0.0, False
    for step in range(100):
        _, _, terminated, _, info = env.step(np.array([3.0], np.float32))
        total += 0.9**step * info["shaping"]
        if terminated:
            break
    # whatever the policy did: shaping does not change which policy is best
    assert terminated and total == pytest.approx(embedding.distance(start, np.zeros(4)))


@pytest.mark.parametrize("autoreset", MODES, ids=lambda mode: mode.value)
def test_vector_shaping_equals_single_shaping(embedding_folder: Path, autoreset: AutoresetMode) -> None:
    def wrap(env: gymnasium.Env) -> gymnasium.Env:
        return PlanSpaceShaping(env, embedding_folder, GOAL)

    ours = PlanSpaceVectorShaping(many(autoreset), embedding_folder, GOAL)
    theirs = one_by_one(wrap, autoreset)
    ours.reset(seed=2)
    theirs.reset(seed=2)
    ours.action_space.seed(0)
    for _ in range(60):
        actions = ours.action_space.sample()
        got, wanted = ours.step(actions), theirs.step(actions)
        np.testing.assert_allclose(got[1], wanted[1], atol=1e-5)
        ended = got[2] | got[3]
        if autoreset == AutoresetMode.DISABLED and ended.any():
            for env in (ours, theirs):
                env.reset(options={"reset_mask": ended})


def test_a_goal_in_the_observation(embedding_folder: Path, embedding: Embedding) -> None:
    class WithGoal(gymnasium.ObservationWrapper[Any, Any, Any]):
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (8,))

        def observation(self, observation: np.ndarray) -> np.ndarray:
            return np.concatenate([observation, np.full(4, 0.5, np.float32)])

    env = PlanSpaceShaping(WithGoal(swing_up()), embedding_folder, goal_columns=[4, 5, 6, 7], discount=1.0)
    states = [env.reset(seed=0)[1]["state"]]
    _, _, _, _, info = env.step(np.ones(1, np.float32))
    far, near = (embedding.distance(x, np.full(4, 0.5)) for x in (states[0], info["state"]))
    assert info["shaping"] == pytest.approx(far - near, abs=1e-5)


def test_misfits_are_refused_at_construction(embedding_folder: Path, tmp_path: Path) -> None:
    pendulum = gymnasium.make("Pendulum-v1")
    with pytest.raises(UsageError, match=r"the embedding reads 4 numbers \(slider, .*\), got 2"):
        PlanSpaceObservation(pendulum, embedding_folder, columns=[0, 1])
    with pytest.raises(UsageError, match="columns .* reach outside an observation of 3 numbers"):
        PlanSpaceObservation(pendulum, embedding_folder, columns=[0, 1, 2, 3])
    with pytest.raises(UsageError, match=r"columns \[0, 1, 2, 2\] name 2 twice"):
        PlanSpaceObservation(pendulum, embedding_folder, columns=[0, 1, 2, 2])
    with pytest.raises(UsageError, match="unknown mode 'both'. Known: augment, dict, replace"):
        PlanSpaceObservation(swing_up(), embedding_folder, mode="both")
    with pytest.raises(PlanspaceError, match="is not an embedding"):
        PlanSpaceObservation(swing_up(), tmp_path)
    with pytest.raises(UsageError, match="columns need a flat Box"):
        PlanSpaceObservation(gymnasium.make("FrozenLake-v1"), embedding_folder, columns=[0])
    with pytest.raises(UsageError, match="the embedding reads states of 4 numbers .*'slider' is missing"):
        PlanSpaceObservation(gymnasium.make("Reacher-v5"), embedding_folder)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "give either the goal, or goal_columns"),
        ({"goal": GOAL, "goal_columns": STATE}, "give either the goal, or goal_columns"),
        ({"goal": [0.0, 0.0]}, "the goal must be a state of 4 finite numbers"),
        ({"goal": {"slider": 0.0}}, "'hinge' is missing"),
        ({"goal": {**GOAL, "hinge": np.nan}}, "the goal must be a state"),
        ({"goal": GOAL, "scale": 0.0}, "scale must be a number above 0"),
        ({"goal": GOAL, "discount": 1.5}, "discount must be a number above 0 and at most 1"),
    ],
)
def test_shaping_is_checked_at_construction(
    embedding_folder: Path, arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        PlanSpaceShaping(swing_up(), embedding_folder, **arguments)


def test_an_environment_without_a_state_is_refused_with_a_hint(embedding_folder: Path) -> None:
    class Stateless(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-1, 1, (6,))

    with pytest.raises(
        UsageError, match=r"neither attributes `state` and `state_names` nor MuJoCo's .* Give columns="
    ):
        PlanSpaceObservation(Stateless(), embedding_folder)


def test_a_state_without_names_is_not_guessed_at(embedding_folder: Path) -> None:
    """Gymnasium's own cart-pole has four numbers, too, in another order."""
    env = gymnasium.make("CartPole-v1")
    env.reset(seed=0)
    with pytest.raises(UsageError, match="neither attributes `state` and `state_names` nor MuJoCo's"):
        PlanSpaceObservation(env, embedding_folder)

    class Short(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-1, 1, (6,))
        state_names = ("slider", "hinge", "slidervel", "hingevel")
        state = np.zeros(2)

    with pytest.raises(
        UsageError, match="has 4 `state_names`, but 2 numbers in its attribute `state`. Give col"
    ):
        PlanSpaceObservation(Short(), embedding_folder)


@pytest.mark.parametrize("autoreset", MODES, ids=lambda mode: mode.value)
def test_infos_of_shaping_are_those_of_single_environments(
    embedding_folder: Path, autoreset: AutoresetMode
) -> None:
    def wrap(env: gymnasium.Env) -> gymnasium.Env:
        return PlanSpaceShaping(env, embedding_folder, GOAL)

    ours = PlanSpaceVectorShaping(many(autoreset), embedding_folder, GOAL)
    theirs = one_by_one(wrap, autoreset)
    infos = [(ours.reset(seed=2)[1], theirs.reset(seed=2)[1])]
    for _ in range(30):
        actions = ours.action_space.sample()
        got, wanted = ours.step(actions), theirs.step(actions)
        infos.append((got[4], wanted[4]))
        if autoreset == AutoresetMode.DISABLED and (got[2] | got[3]).any():
            for env in (ours, theirs):
                env.reset(options={"reset_mask": got[2] | got[3]})
    for got, wanted in infos:
        assert got.keys() == wanted.keys()
        finals = [(got["final_info"], wanted["final_info"])] if "final_info" in wanted else []
        for a, b in [(got, wanted), *finals]:
            np.testing.assert_allclose(a["shaping"], b["shaping"], atol=1e-5)
            np.testing.assert_array_equal(a["_shaping"], b["_shaping"])


def test_wraps_wrapped_environments(embedding_folder: Path) -> None:
    bounded = gymnasium.make("Pendulum-v1")
    inner = RescaleObservation(bounded, np.float32(-1), np.float32(1))
    with pytest.raises(UsageError, match="got 3"):
        PlanSpaceObservation(inner, embedding_folder, columns=[0, 1, 2])
