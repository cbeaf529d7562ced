import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers import FlattenObservation, NormalizeObservation, TransformObservation
from gymnasium.wrappers.vector import NormalizeObservation as VectorNormalizeObservation

from planspace.envs.wrappers import PlanSpaceObservation, PlanSpaceShaping, PlanSpaceVectorObservation

from .goal_env import COLUMNS, GOAL, NAMES, point_embedding, point_env

E = point_embedding()
NORMALISED = "wrapped in NormalizeObservation.* after planspace's wrapper"
OUTSIDE = (
    r"100% of the first 200 states lie outside the demonstrations.*: 'x' is between .* here, and between "
    r".* in the demonstrations. The observation passes through TransformObservation"
)


def centimetres(env: gymnasium.Env) -> gymnasium.Env:
    """The positions in another unit, and far away."""
    flat = FlattenObservation(env)
    return TransformObservation(flat, lambda obs: 100 * obs + 1000, flat.observation_space)


def run(env: Any, steps: int = 210) -> None:
    env.reset(seed=0)
    for _ in range(steps):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        if np.any(terminated | truncated) and not isinstance(env, gymnasium.vector.VectorEnv):
            env.reset()


def test_normalised_observations_are_reported_at_once() -> None:
    with pytest.warns(UserWarning, match=NORMALISED):
        PlanSpaceObservation(NormalizeObservation(FlattenObservation(point_env())), E, columns=[4, 5, 6, 7])
    with pytest.warns(UserWarning, match=NORMALISED):
        many = SyncVectorEnv([lambda: FlattenObservation(point_env())])
        PlanSpaceVectorObservation(VectorNormalizeObservation(many), E, columns=[4, 5, 6, 7])
    with pytest.warns(UserWarning, match=NORMALISED):
        env = NormalizeObservation(FlattenObservation(point_env()))
        PlanSpaceShaping(env, E, dict.fromkeys(NAMES, 0.0), columns=[4, 5, 6, 7])


def test_normalising_outside_of_the_wrapper_is_not_reported() -> None:
    run(NormalizeObservation(PlanSpaceObservation(FlattenObservation(point_env()), E, columns=COLUMNS)))


def test_states_read_by_name_are_not_changed_by_normalising(embedding_folder) -> None:
    env = NormalizeObservation(gymnasium.make("planspace/CartPole-v0"))
    PlanSpaceObservation(env, embedding_folder)


def test_other_units_are_reported_once_with_an_example() -> None:
    env = PlanSpaceObservation(centimetres(point_env()), E, columns=COLUMNS)
    with pytest.warns(UserWarning, match=OUTSIDE) as caught:
        run(env)
    assert len(caught) == 1
    run(env)


def test_a_vector_environment_reports_them_too() -> None:
    env = PlanSpaceVectorObservation(
        SyncVectorEnv([lambda: centimetres(point_env())] * 8), E, columns=COLUMNS
    )
    with pytest.warns(UserWarning, match=OUTSIDE):
        run(env, steps=30)


def test_shaping_reports_them_too() -> None:
    env = PlanSpaceShaping(
        centimetres(point_env()), E, dict.fromkeys(NAMES, 0.0), columns=["4", "5", "6", "7"]
    )
    with pytest.warns(UserWarning, match=OUTSIDE):
        run(env)


def test_states_of_the_demonstrations_are_not_reported() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(PlanSpaceObservation(point_env(), E, columns=COLUMNS, goal=GOAL), steps=400)
