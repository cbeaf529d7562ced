"""Hostile policies are rejected, and nothing else happens."""

from pathlib import Path

import numpy as np
import pytest

from planspace.rl.play import make_env
from planspace.rl.saved_policy import load_policy, save_policies
from planspace.storage.arrays import read_arrays, write_arrays

from .audit import CANARY, Change, assert_rejected, nothing_else_happens, reseal

FOREIGN = "names the environment .* for the task"
POLICIES: dict[str, tuple[Change, str]] = {
    "code as environment": (lambda d: d.update(env_id=f"{CANARY}:Foo-v0"), FOREIGN),
    "code before an environment": (lambda d: d.update(env_id=f"{CANARY}:planspace/CartPole-v0"), FOREIGN),
    "code as task": (lambda d: d.update(task=f"{CANARY}:Foo-v0"), FOREIGN),
    "code as both": (lambda d: d.update(task=f"{CANARY}:a", env_id=f"{CANARY}:a"), FOREIGN),
    "environment of another task": (lambda d: d.update(env_id="planspace/Arm-v0"), FOREIGN),
    "environment of Gymnasium": (lambda d: d.update(task="CartPole-v1", env_id="CartPole-v1"), FOREIGN),
    "null as task and environment": (lambda d: d.update(task=None, env_id=None), "is not a name"),
    "list as environment": (lambda d: d.update(env_id=["planspace/CartPole-v0"]), "is invalid"),
    "no environment": (lambda d: d.pop("env_id"), "is invalid .*env_id"),
    "no task": (lambda d: d.pop("task"), "is invalid .*task"),
    "unknown observation type": (lambda d: d.update(obs="pickle"), "is invalid .*obs is 'pickle'"),
    "no observation type": (lambda d: d.pop("obs"), "is invalid .*obs is None"),
    "unknown reward": (
        lambda d: d.update(reward="os:system"),
        "is invalid .*reward is 'os:system'",
    ),
    "z without an embedding": (lambda d: d.update(z="augment"), "is invalid .*an embedding for each seed"),
    "invalid receiver of z": (
        lambda d: d.update(z_to=[1] * 9999),
        r"is invalid .*z_to is \[1, 1, .*\.\.\.\]",
    ),
    "embedding outside": (
        lambda d: d.update(embeddings=["../../secret/embedding"]),
        "is invalid",
    ),
    "huge observations": (lambda d: d.update(num_obs=10**12), "is invalid"),
    "columns that do not exist": (lambda d: d.update(columns=[5, 9]), "is invalid"),
    "no seeds": (lambda d: d.update(seeds=[], returns=[]), "is invalid"),
    "text as a seed": (lambda d: d.update(seeds=["\x1b[2J"]), "is invalid .*not whole numbers"),
    "text as a return": (lambda d: d.update(returns=["x"]), "is invalid"),
    "huge action bound": (
        lambda d: d.update(action_low=[-1e308]),
        "is invalid .*limit of its actions",
    ),
    "text as an action bound": (lambda d: d.update(action_high=["pickle"]), "is invalid"),
    "equal action bounds": (lambda d: d.update(action_low=[1.0]), "is invalid .*no range"),
}
POLICY_WEIGHTS: dict[str, tuple[Change, str]] = {
    "too large weights": (lambda a: a["1.weight"].fill(3e38), "an action of seed 0 is not finite"),
    "infinite standard deviation": (lambda a: a["log_std"].fill(1e4), "is invalid .*no standard deviation"),
    "negative variance": (lambda a: a.update(statistics(-1.0)), "an action of seed 0 is not finite"),
}


def statistics(squares: float) -> dict[str, np.ndarray]:
    return {"num": np.ones(1), "mean": np.zeros((1, 2)), "squares": np.full((1, 2), squares)}


@pytest.fixture
def policies(tmp_path: Path) -> Path:
    """A run with one policy of two layers."""
    arrays = {"0.weight": np.ones((1, 2, 2), np.float32), "1.weight": np.ones((1, 1, 2), np.float32)}
    arrays |= {"0.bias": np.zeros((1, 2), np.float32), "1.bias": np.ones((1, 1), np.float32)}
    about = {"task": "cartpole", "env_id": "planspace/CartPole-v0", "obs": "raw", "z": "none", "z_to": "both"}
    about |= {"seeds": [0], "returns": [1.0], "layer_norm": False, "columns": [0, 2], "num_obs": 2}
    about |= {"action_low": [-1.0], "action_high": [1.0], "embeddings": []}
    run = tmp_path / "run"
    run.mkdir()
    save_policies(run, {**arrays, "log_std": np.zeros((1, 1), np.float32)}, about)
    load_policy(run)
    return run


@pytest.mark.usefixtures("canary")
@pytest.mark.parametrize("trick", POLICIES)
def test_false_descriptions_are_rejected(trick: str, policies: Path) -> None:
    change, message = POLICIES[trick]
    reseal(policies / "policies.json", change)
    assert_rejected(policies, lambda: load_policy(policies), message)


@pytest.mark.parametrize("trick", POLICY_WEIGHTS)
def test_invalid_weights_are_rejected(trick: str, policies: Path) -> None:
    change, message = POLICY_WEIGHTS[trick]
    arrays = {name: array.copy() for name, array in read_arrays(policies / "policies.safetensors").items()}
    change(arrays)
    write_arrays(policies / "policies.safetensors", arrays)
    reseal(policies / "policies.json", lambda content: None)
    assert_rejected(policies, lambda: load_policy(policies), message)


@pytest.mark.usefixtures("canary")
def test_a_policy_plays_in_the_environment_of_its_task(policies: Path) -> None:
    policy = load_policy(policies)
    policy.about["env_id"] = f"{CANARY}:planspace/CartPole-v0"
    with nothing_else_happens(policies):
        env = make_env(policy)
    assert env.unwrapped.task.name == "cartpole"  # pyright: ignore
