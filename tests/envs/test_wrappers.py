import inspect
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RescaleObservation

from planspace.embed.embedding import Embedding
from planspace.envs.wrappers import PlanSpaceObservation
from planspace.errors import PlanspaceError, UsageError


def swing_up() -> gymnasium.Env:
    return gymnasium.make("planspace/CartPoleSwingUp-v0")


@pytest.mark.parametrize("columns", [None, [0, 1, 2, 3]])
def test_augment_appends_the_mean(
    embedding_folder: Path, embedding: Embedding, columns: list[int] | None
) -> None:
    env = PlanSpaceObservation(swing_up(), embedding_folder, columns=columns)
    obs, info = env.reset(seed=0)
    for _ in range(3):
        np.testing.assert_allclose(obs, np.append(info["state"], embedding.encode(info["state"])), atol=1e-5)
        assert obs in env.observation_space
        obs, _, _, _, info = env.step(env.action_space.sample())


def test_replace_gives_z_alone(embedding_folder: Path, embedding: Embedding) -> None:
    env = PlanSpaceObservation(swing_up(), embedding_folder, mode="replace")
    obs, info = env.reset(seed=0)
    np.testing.assert_allclose(obs, embedding.encode(info["state"]), atol=1e-6)
    assert env.observation_space.shape == (3,)


def test_the_spec_survives_json_with_every_argument(embedding_folder: Path) -> None:
    env = PlanSpaceObservation(swing_up(), embedding_folder, mode="replace", columns=[0, 1, 2, 3])
    recorded = set(env._saved_kwargs)
    assert recorded == set(inspect.signature(PlanSpaceObservation).parameters) - {"env"}
    assert env.spec is not None
    again = gymnasium.make(type(env.spec).from_json(env.spec.to_json()))
    np.testing.assert_array_equal(again.reset(seed=3)[0], env.reset(seed=3)[0])


def test_what_does_not_fit_is_refused_at_construction(embedding_folder: Path, tmp_path: Path) -> None:
    pendulum = gymnasium.make("Pendulum-v1")
    with pytest.raises(UsageError, match=r"the embedding reads 4 numbers \(slider, .*\), got 2"):
        PlanSpaceObservation(pendulum, embedding_folder, columns=[0, 1])
    with pytest.raises(UsageError, match="columns .* reach outside an observation of 3 numbers"):
        PlanSpaceObservation(pendulum, embedding_folder, columns=[0, 1, 2, 3])
    with pytest.raises(UsageError, match="mode is 'augment' or 'replace', got 'both'"):
        PlanSpaceObservation(swing_up(), embedding_folder, mode="both")  # pyright: ignore
    with pytest.raises(PlanspaceError, match="is not an embedding"):
        PlanSpaceObservation(swing_up(), tmp_path)
    with pytest.raises(UsageError, match="must be a flat Box"):
        PlanSpaceObservation(gymnasium.make("FrozenLake-v1"), embedding_folder, columns=[0])


def test_an_environment_without_a_state_is_told_what_to_give(embedding_folder: Path) -> None:
    class Stateless(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-1, 1, (6,))

    with pytest.raises(UsageError, match=r"no attribute `state` to read; give columns=\[...\]"):
        PlanSpaceObservation(Stateless(), embedding_folder)


def test_stands_on_other_wrappers(embedding_folder: Path) -> None:
    bounded = gymnasium.make("Pendulum-v1")
    inner = RescaleObservation(bounded, np.float32(-1), np.float32(1))
    with pytest.raises(UsageError, match="got 3"):
        PlanSpaceObservation(inner, embedding_folder, columns=[0, 1, 2])
