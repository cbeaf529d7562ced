import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

from planspace.envs.embedding_box import EmbeddingBox
from planspace.envs.wrappers import PlanSpaceObservation, PlanSpaceVectorObservation

from .goal_env import COLUMNS, GOAL, point_embedding, point_env

FIRST, SECOND = point_embedding(0), point_embedding(1)


@pytest.mark.parametrize("mode", ["augment", "dict", "replace"])
def test_the_space_of_another_embedding_of_the_same_size_is_another(mode: str) -> None:
    def space(embedding) -> gymnasium.Space:
        flat = gymnasium.wrappers.FlattenObservation(point_env())
        return PlanSpaceObservation(flat, embedding, mode, COLUMNS).observation_space

    assert space(FIRST) == space(FIRST) == copy.deepcopy(space(FIRST))
    assert space(FIRST) != space(SECOND)
    assert (
        pickle.loads(pickle.dumps(space(FIRST))) == space(FIRST) != pickle.loads(pickle.dumps(space(SECOND)))
    )
    assert FIRST.hash[:12] in repr(space(FIRST))


def test_z_of_goals_and_vector_environments_have_it_too() -> None:
    env = PlanSpaceObservation(point_env(), FIRST, columns=COLUMNS, goal=GOAL)
    assert env.observation_space["z_difference"].embedding_hash == FIRST.hash  # pyright: ignore
    many = gymnasium.make_vec("CartPole-v1", num_envs=2, vectorization_mode="vector_entry_point")
    shown = PlanSpaceVectorObservation(many, FIRST, columns=[0, 1, 2, 3])
    assert isinstance(shown.single_observation_space, EmbeddingBox)


def test_a_plain_box_of_an_older_agent_is_accepted() -> None:
    limit = np.full(3, np.inf, np.float32)
    ours = EmbeddingBox(-limit, limit, np.float32, FIRST.hash)
    plain = Box(-limit, limit, dtype=np.float32)
    assert ours == plain and plain == ours
    assert ours != Box(-limit[:2], limit[:2], dtype=np.float32)


@pytest.mark.slow
def test_sb3_refuses_an_agent_that_saw_another_embedding(tmp_path) -> None:
    PPO = pytest.importorskip("stable_baselines3", reason="needs the extra sb3").PPO

    def env(embedding) -> gymnasium.Env:
        return PlanSpaceObservation(point_env(), embedding, columns=COLUMNS)

    PPO("MultiInputPolicy", env(FIRST), n_steps=8, batch_size=8, device="cpu").save(tmp_path / "agent")
    PPO.load(tmp_path / "agent", env(FIRST), device="cpu")
    with pytest.raises(ValueError, match=f"Observation spaces do not match.*{SECOND.hash[:12]}"):
        PPO.load(tmp_path / "agent", env(SECOND), device="cpu")
