import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from planspace.embed.embedding import Embedding
from planspace.envs.wrappers import PlanSpaceObservation
from planspace.errors import UsageError
from planspace.mjcf.assets import ASSETS

pytest.importorskip("stable_baselines3", reason="needs the extra sb3")

from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from planspace.envs.sb3 import GymnasiumVecEnv, make_vec_env

SWING_UP, BALANCE = "planspace/CartPoleSwingUp-v0", "planspace/CartPole-v0"


@pytest.mark.parametrize("mode", ["augment", "dict"])
def test_ours_does_what_sb3s_own_does(embedding_folder: Path, mode: str) -> None:
    """Step by step, over episodes that end by themselves and such as are cut off."""

    def single() -> gymnasium.Env:
        return PlanSpaceObservation(gymnasium.make(BALANCE, max_episode_steps=8), embedding_folder, mode)

    ours = make_vec_env(BALANCE, 4, 7, embedding_folder, mode, env_kwargs={"max_episode_steps": 8})
    theirs = DummyVecEnv([single] * 4)
    theirs.seed(7)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    alike(ours.reset(), theirs.reset())
    rng = np.random.default_rng(0)
    seen = set()
    for _ in range(60):
        actions = rng.uniform([[-0.1], [-0.1], [2], [2]], [[0.1], [0.1], [3], [3]]).astype(np.float32)
        got, wanted = ours.step(actions), theirs.step(actions)
        alike(got[0], wanted[0])
        for a, b in zip(got[1:3], wanted[1:3], strict=True):
            assert a.dtype == b.dtype and np.array_equal(a, b)
        for i in range(4):
            assert got[3][i].keys() - {"episode"} == wanted[3][i].keys()
            assert got[3][i]["TimeLimit.truncated"] == wanted[3][i]["TimeLimit.truncated"]
            alike(got[3][i]["state"], wanted[3][i]["state"])
            if got[2][i]:
                alike(got[3][i]["terminal_observation"], wanted[3][i]["terminal_observation"])
                assert got[3][i]["episode"]["l"] <= 8
                alike(ours.venv.reset_infos[i]["state"], theirs.reset_infos[i]["state"])
                seen.add(got[3][i]["TimeLimit.truncated"])
    assert seen == {False, True}


def alike(a: Any, b: Any) -> None:
    if isinstance(b, dict):
        assert a.keys() == b.keys()
        for key in b:
            alike(a[key], b[key])
    else:
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, atol=1e-5)  # one product of many rows rounds otherwise


def test_it_can_be_normalised_seeded_drawn_and_started_anywhere(embedding: Embedding) -> None:
    inner = make_vec_env(SWING_UP, 3, env_kwargs={"render_mode": "rgb_array"})
    env = VecNormalize(inner)
    starts = []
    for _ in range(2):
        env.seed(3)
        env.reset()
        starts.append(env.get_original_obs())
    assert np.array_equal(*starts)
    env.set_options({"state": [0.1, 0.2, 0.3, 0.4]})
    np.testing.assert_allclose(inner.venv.reset(), [[0.1, 0.2, 0.3, 0.4]] * 3, atol=1e-6)
    assert [info["state"].tolist() for info in inner.venv.reset_infos] == [[0.1, 0.2, 0.3, 0.4]] * 3
    assert env.get_attr("state_names")[2] == embedding.inputs.names
    assert not env.has_attr("no_such_thing")
    assert env.env_is_wrapped(PlanSpaceObservation) == [False] * 3
    env.close()


def test_a_task_or_a_problem_file_stands_for_its_id() -> None:
    registered, named, own = (
        make_vec_env(env_id, 2, 5) for env_id in (SWING_UP, "cartpole-swingup", ASSETS / "pendulum.yaml")
    )
    np.testing.assert_array_equal(registered.reset(), named.reset())
    own.reset()
    assert own.step(np.zeros((2, 1)))[0].shape == (2, 2)


def test_misfits_are_refused() -> None:
    slow = gymnasium.make_vec(BALANCE, num_envs=2, vectorization_mode="vector_entry_point")
    with pytest.raises(UsageError, match="SB3 needs environments with autoreset_mode='SameStep', got"):
        GymnasiumVecEnv(slow)
    with pytest.raises(UsageError, match="Pendulum-v1 has no vector environment; use SB3's own"):
        make_vec_env("Pendulum-v1")
    with pytest.raises(UsageError, match="CartPole-v1 has no argument autoreset_mode, and SB3 needs 'SameSt"):
        make_vec_env("CartPole-v1", 2)  # one of Gymnasium's own vector environments
    with pytest.raises(TypeError, match="no_such_argument"):
        make_vec_env(BALANCE, env_kwargs={"no_such_argument": 1})
    env = make_vec_env(BALANCE, 2)
    with pytest.raises(UsageError, match="cannot call jump: the vector environment has no single"):
        env.env_method("jump")
    with pytest.raises(UsageError, match="all environments share obs: set it without indices"):
        env.set_attr("obs", "trig", indices=0)
    env.set_options({"speed": 3})
    with pytest.raises(UsageError, match="the only option is a start state for every environment"):
        env.reset()
    env.reset()  # the options are gone
    assert make_vec_env("planspace:planspace/CartPole-v0").venv.env.spec.to_json()  # pyright: ignore


def test_any_vector_environment_of_gymnasium_works() -> None:
    from gymnasium.vector import AutoresetMode

    plain = SyncVectorEnv([lambda: gymnasium.make("Pendulum-v1")] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    env = GymnasiumVecEnv(plain)
    assert env.reset().shape == (2, 3)
    assert env.step(np.zeros((2, 1), np.float32))[1].shape == (2,)


def test_without_sb3_the_error_names_the_package() -> None:
    code = "import sys; sys.modules['stable_baselines3'] = None; import planspace.envs.sb3"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "PlanspaceError: Stable-Baselines3 is not installed: pip install " in done.stderr
