from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from planspace.envs.wrappers import PlanSpaceVectorObservation, PlanSpaceVectorShaping

from .goal_env import NAMES, point_embedding

E = point_embedding()


class OneArray(VectorEnv):
    """Its `final_obs` is one array for all environments, or a dictionary of such arrays."""

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012
    num_envs = 3
    single_action_space, action_space = Box(-1, 1, (1,)), Box(-1, 1, (3, 1))

    def __init__(self, keyed: bool):
        box = Box(-np.inf, np.inf, (4,), np.float32)
        self.keyed = keyed
        self.single_observation_space: Any = Dict({"observation": box}) if keyed else box
        self.observation_space = batch_space(self.single_observation_space, 3)

    def shown(self, first: float) -> Any:
        states = first + np.arange(12, dtype=np.float32).reshape(3, 4)
        return {"observation": states} if self.keyed else states

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        return self.shown(0.0), {}

    def step(self, actions: Any) -> Any:
        ended = np.array([True, False, True])
        final = self.shown(100.0)
        if self.keyed:
            final["_observation"] = ended.copy()
        info = {"final_obs": final, "_final_obs": ended}
        return self.shown(50.0), np.zeros(3), ended, np.zeros(3, bool), info


@pytest.mark.parametrize("mode", ["augment", "dict", "replace"])
@pytest.mark.parametrize("keyed", [False, True])
def test_z_is_added_to_last_observations_in_one_array(mode: str, keyed: bool) -> None:
    env = PlanSpaceVectorObservation(OneArray(keyed), E, mode, [0, 1, 2, 3])
    env.reset()
    final = env.step(np.zeros((3, 1)))[4]["final_obs"]
    states = 100.0 + np.arange(12).reshape(3, 4)[[0, 2]]
    z = final if mode == "replace" else final["z"] if isinstance(final, dict) else final[:, 4:]
    np.testing.assert_allclose(z[[0, 2]], E.encode(states), rtol=1e-5)
    if mode != "replace":
        seen = final["observation"] if isinstance(final, dict) else final[:, :4]
        np.testing.assert_array_equal(seen[[0, 2]], states)
    if not isinstance(final, dict):
        assert final.shape == env.observation_space.shape


@pytest.mark.parametrize("keyed", [False, True])
def test_shaping_reads_last_observations_in_one_array(keyed: bool) -> None:
    env = PlanSpaceVectorShaping(OneArray(keyed), E, dict.fromkeys(NAMES, 0.0), columns=[0, 1, 2, 3])
    env.reset()
    before = -E.distance(np.arange(12.0).reshape(3, 4), np.zeros(4))
    after = -E.distance(50.0 + np.arange(12.0).reshape(3, 4), np.zeros(4))
    wanted = np.where([True, False, True], 0.0, 0.99 * after) - before  # two episodes terminated
    np.testing.assert_allclose(env.step(np.zeros((3, 1)))[1], wanted, rtol=1e-4)


@pytest.mark.parametrize("keyed", [False, True])
def test_sb3_gets_last_observations_of_one_array(keyed: bool) -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra sb3")
    from planspace.envs.sb3 import GymnasiumVecEnv

    env = GymnasiumVecEnv(PlanSpaceVectorObservation(OneArray(keyed), E, "augment", [0, 1, 2, 3]))
    env.reset()
    infos = env.step(np.zeros((3, 1), np.float32))[3]
    last = infos[2]["terminal_observation"]
    z = last["z"] if keyed else last[4:]
    np.testing.assert_allclose(z, E.encode(np.arange(108.0, 112.0)), rtol=1e-5)
    assert last in env.observation_space and "terminal_observation" not in infos[1]


def test_a_vector_environment_of_gymnasium_without_same_step_works() -> None:
    env = PlanSpaceVectorObservation(
        gymnasium.make_vec("CartPole-v1", num_envs=2, vectorization_mode="vector_entry_point"),
        E,
        columns=[0, 1, 2, 3],
    )
    obs, _ = env.reset(seed=0)
    np.testing.assert_allclose(obs[:, 4:], E.encode(obs[:, :4]), atol=1e-6)
