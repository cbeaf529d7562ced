import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.load import load_demos
from planspace.errors import PlanspaceError, UsageError
from tests.demos.formats.minari_datasets import NAME, load


def record(
    minari, env_id: str, infos: bool = True, num: int = 2, wrap=lambda env: env, **kwargs
) -> np.ndarray:
    """Record random episodes of a task and return the states of the last one."""
    import gymnasium

    env = minari.DataCollector(wrap(gymnasium.make(env_id, **kwargs)), record_infos=infos)
    folders = [env._tmp_dir]
    env.action_space.seed(0)
    for seed in range(num):
        states = [env.reset(seed=seed)[1]["state"]]
        for _ in range(15):
            states.append(env.step(env.action_space.sample())[4]["state"])
    with pytest.warns(UserWarning):
        env.create_dataset(NAME)
    for folder in [*folders, env._tmp_dir]:  # otherwise Minari warns when they are garbage collected
        folder.cleanup()
    return np.array(states)


@pytest.mark.parametrize("infos", [True, False])
@pytest.mark.parametrize("obs", ["raw", "trig"])
def test_states_of_a_recorded_task_are_known(minari, infos: bool, obs: str) -> None:
    states = record(minari, "planspace/CartPoleSwingUp-v0", infos, obs=obs)
    demos = load_demos(f"minari:{NAME}")
    assert demos.info.names == ("slider", "hinge", "slidervel", "hingevel")
    assert demos.info.problem == "cartpole-swingup" and demos.info.circular_columns == (1,)
    assert len(demos) == 2
    last = demos.episode(1)
    np.testing.assert_allclose(last.times, 0.04 * np.arange(16))
    off = (
        np.round((last.states - states) / (2 * np.pi)) * 2 * np.pi
    )  # full turns: a stored angle ends in (-pi, pi]
    np.testing.assert_allclose(last.states - off, states, rtol=1e-6)
    np.testing.assert_array_equal(off[:, [0, 2, 3]], 0.0)


def test_a_recorded_task_provides_the_states_of_a_problem(minari, tmp_path: Path) -> None:
    from planspace.plan.demonstrations import state_info
    from planspace.tasks.problem_file import load_problem

    record(minari, "planspace/CartPoleSwingUp-v0")
    balance = load(tmp_path, info=state_info(load_problem("cartpole")))
    assert balance.info.problem == "cartpole" and len(balance) == 2
    with pytest.raises(
        UsageError, match="recorded from planspace/CartPoleSwingUp-v0, .*has a state 'shoulder'"
    ):
        load(tmp_path / "other", info=state_info(load_problem("acrobot")))


def test_changed_observations_are_not_used_as_states(minari, capsys: pytest.CaptureFixture[str]) -> None:
    from gymnasium.wrappers import NormalizeObservation, RescaleAction

    def rescaled(env):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Gymnasium warns about bounds that are not float32
            return RescaleAction(env, -1.0, 1.0)

    record(minari, "planspace/CartPoleSwingUp-v0", wrap=NormalizeObservation, infos=False)
    with pytest.raises(UsageError, match="do not contain the states"):
        load_demos(f"minari:{NAME}")
    minari.delete_dataset(NAME)
    record(minari, "planspace/CartPoleSwingUp-v0", wrap=rescaled)
    load_demos(f"minari:{NAME}")
    assert "recorded through RescaleAction: the applied controls may differ" in capsys.readouterr().err


@pytest.mark.parametrize(
    "spec", ['{"kwargs": null}', '{"kwargs": {"obs": 3}}', '{"additional_wrappers": [1]}']
)
def test_a_damaged_environment_spec(minari, spec: str) -> None:
    from planspace.demos.formats.recorded_task import recorded_task

    damaged = {"env_spec": json.dumps({"id": "planspace/CartPole-v0", **json.loads(spec)})}
    with pytest.raises(PlanspaceError, match="the environment spec in the metadata of 'x' is damaged"):
        recorded_task(damaged, "x")
    assert recorded_task({"env_spec": "{"}, "x") is None


def test_shaped_episodes_can_be_recorded(minari, embedding_folder: Path) -> None:
    from planspace.envs.wrappers import PlanSpaceShaping

    record(
        minari,
        "planspace/CartPoleSwingUp-v0",
        wrap=lambda e: PlanSpaceShaping(e, embedding_folder, [0.0] * 4),
    )
    assert len(load_demos(f"minari:{NAME}")) == 2


def test_error_says_how_to_record_missing_states(minari) -> None:
    record(minari, "planspace/ReacherTrig-v0", infos=False)
    with pytest.raises(UsageError, match=r"do not contain the states \(joint0, .*record_infos=True"):
        load_demos(f"minari:{NAME}")


@pytest.mark.nightly
def test_embed_a_recorded_task(minari, tmp_path: Path, capsys) -> None:
    from planspace import load_embedding
    from planspace.cli import main

    record(minari, "planspace/ReacherTrig-v0", num=12)
    small = ["--steps", "20", "--batch", "16", "--seeds", "1"]
    assert main(["embed", f"minari:{NAME}", "--out", str(tmp_path / "e"), *small]) == 0
    capsys.readouterr()
    assert load_embedding(tmp_path / "e").inputs.names == ("joint0", "joint1", "joint0vel", "joint1vel")
