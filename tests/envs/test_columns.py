from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers import FlattenObservation, RescaleObservation
from gymnasium.wrappers.vector import FlattenObservation as VectorFlattenObservation

from planspace.envs.columns import read_columns
from planspace.envs.wrappers import PlanSpaceObservation, PlanSpaceVectorObservation
from planspace.errors import UsageError

from .goal_env import COLUMNS, point_embedding, point_env

E = point_embedding()
OTHER_ORDER = ["observation[2]", "achieved_goal[1]", "observation[0]", "desired_goal[0]"]


def state_of(obs: dict[str, np.ndarray], columns: list[Any]) -> np.ndarray:
    return np.array([obs[c[:-3]][int(c[-2])] for c in columns])


@pytest.mark.parametrize("columns", [COLUMNS, OTHER_ORDER])
def test_columns_by_the_importers_names(columns: list[str]) -> None:
    env = PlanSpaceObservation(point_env(), E, columns=columns)
    obs, _ = env.reset(seed=0)
    np.testing.assert_allclose(obs["z"], E.encode(state_of(obs, columns)), atol=1e-6)


@pytest.mark.parametrize("columns", [[0, 1, 2, 3], ["0", "1", "2", "3"]])
def test_numbers_refer_to_observation_as_in_the_importer(columns: list[Any]) -> None:
    env = PlanSpaceObservation(point_env(), E, columns=columns)
    obs, _ = env.reset(seed=0)
    np.testing.assert_allclose(obs["z"], E.encode(obs["observation"]), atol=1e-6)


@pytest.mark.parametrize("columns", [COLUMNS, OTHER_ORDER])
def test_names_work_after_flattening(columns: list[str]) -> None:
    plain = point_env().reset(seed=0)[0]
    wanted = E.encode(state_of(plain, columns))
    single = PlanSpaceObservation(FlattenObservation(point_env()), E, columns=columns)
    np.testing.assert_allclose(single.reset(seed=0)[0][-3:], wanted, atol=1e-6)
    flat_inside = SyncVectorEnv([lambda: FlattenObservation(point_env())])
    flat_outside = VectorFlattenObservation(SyncVectorEnv([point_env]))
    for env in (flat_inside, flat_outside):
        many = PlanSpaceVectorObservation(env, E, columns=columns)
        np.testing.assert_allclose(many.reset(seed=0)[0][0, -3:], wanted, atol=1e-6)


def test_numbers_that_would_read_goals_after_flattening_are_refused() -> None:
    """Gymnasium sorts the keys, so that columns 0 to 3 are the goals."""
    with pytest.raises(
        UsageError,
        match=r"are achieved_goal\[0\], achieved_goal\[1\], desired_goal\[0\], desired_goal\[1\], because .* "
        r"achieved_goal, desired_goal, observation. Give columns by name: 'observation\[0\]' is column 4",
    ):
        PlanSpaceObservation(FlattenObservation(point_env()), E, columns=[0, 1, 2, 3])
    env = PlanSpaceObservation(FlattenObservation(point_env()), E, columns=[4, 5, 6, 7])
    obs = env.reset(seed=0)[0]
    np.testing.assert_allclose(obs[-3:], E.encode(obs[4:8]), atol=1e-6)


def test_a_wrapper_that_changes_the_space_after_flattening_ends_the_names() -> None:
    class Half(gymnasium.ObservationWrapper[Any, Any, Any]):
        observation_space = Box(-np.inf, np.inf, (4,))

        def observation(self, observation: np.ndarray) -> np.ndarray:
            return observation[:4]

    with pytest.raises(
        UsageError, match=r"column 'observation\[0\]' is a name, but .* flat Box of 4 numbers"
    ):
        PlanSpaceObservation(Half(FlattenObservation(point_env())), E, columns=COLUMNS)


def test_an_entry_with_one_number_needs_no_index() -> None:
    space = Dict({"height": Box(-1, 1, (1,)), "speed": Box(-1, 1, (2,))})
    reader = read_columns(point_env(), space, ["height", "speed[1]"])
    obs = {"height": np.array([[1.0], [2.0]]), "speed": np.array([[3.0, 4.0], [5.0, 6.0]])}
    np.testing.assert_array_equal(reader(obs, {}), [[1.0, 4.0], [2.0, 6.0]])


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (["position[0]"], "no key 'position'; its keys are image, kind, speed"),
        (["speed"], r"'speed' has 2 numbers; write 'speed\[0\]' to 'speed\[1\]'"),
        (["speed[2]"], r"'speed' has 2 numbers; write"),
        ([0], r"needs a key, because the observation has no entry 'observation': write 'KEY\[0\]'"),
        (["image[0]"], "the entry 'image' is not a flat Box, but Box"),
        (["kind"], "the entry 'kind' is not a flat Box, but Discrete"),
        ([True], r"columns must be whole numbers, or names such as 'observation\[0\]', got True"),
    ],
)
def test_columns_that_cannot_be_read_are_refused(columns: list[Any], message: str) -> None:
    space = Dict({"image": Box(0, 1, (2, 2)), "kind": Discrete(3), "speed": Box(-1, 1, (2,))})
    with pytest.raises(UsageError, match=message):
        read_columns(point_env(), space, columns)


def test_a_flat_observation_has_no_names() -> None:
    env = RescaleObservation(gymnasium.make("Pendulum-v1"), np.float32(-1), np.float32(1))
    for column, message in (("observation[0]", "is a name, but"), (3, "3 is not between 0 and 2")):
        with pytest.raises(UsageError, match=message):
            read_columns(env, env.observation_space, [column])
    with pytest.raises(UsageError, match="columns must be a list of numbers or names, got 'observation'"):
        PlanSpaceObservation(point_env(), E, columns="observation")
