import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from planspace import load_policy
from planspace.cli import main
from planspace.embed.embedding import Embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.errors import PlanspaceError, UsageError
from planspace.rl import training
from planspace.rl.algorithms import find_algorithm
from planspace.rl.algorithms.sac import SAC
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.rl.play import make_env, play
from planspace.rl.policy_network import Actor
from planspace.rl.training import train_policies
from planspace.storage.arrays import read_arrays, write_arrays
from planspace.storage.json_files import read_sealed, write_sealed

ARMS = {
    "plain": {},
    "z": {"obs": "trig", "z": "augment", "algorithm": find_algorithm("ppo", "modern")},
    "z to the critic": {"z": "augment", "z_to": "critic"},
    "z only": {"z": "replace"},
    "z only, to the policy": {"z": "replace", "z_to": "policy"},
    "z, SAC": {
        "z": "augment",
        "z_to": "policy",
        "algorithm": SAC(normalise_obs=True, updates_per_step=1e-3),
    },
}


@pytest.fixture(
    scope="module",
    params=["plain", "z", *(pytest.param(x, marks=pytest.mark.nightly) for x in list(ARMS)[2:])],
)
def run(
    request: pytest.FixtureRequest, embedding_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list]:
    """A short run and its final networks."""
    folder = tmp_path_factory.mktemp("policies") / "run"
    config = TrainConfig(num_seeds=2, seed=4, steps=2 * BATCH_STEPS, **ARMS[request.param])
    kept, networks = [], training._networks

    def spy(*args):
        kept.append(networks(*args))
        return kept[-1]

    given = load_embedding(embedding_folder) if config.z != "none" else None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "_networks", spy)
        train_policies("cartpole-swingup", config, embedding=given, out=folder)
    return folder, kept[-1]


def test_a_loaded_policy_acts_as_in_training(run: tuple[Path, list], rng: np.random.Generator) -> None:
    folder, networks = run
    policies = [load_policy(folder, seed) for seed in (4, 5)]
    about = policies[0].about
    obs = rng.normal(size=(2, 7, about["num_obs"])).astype(np.float32)
    wanted = np.clip(Actor(networks, policies[0].columns)(obs, np.zeros((2, 7, 1))), -3, 3)
    for i, policy in enumerate(policies):
        np.testing.assert_allclose(policy(obs[i]), wanted[i], atol=1e-5)
        np.testing.assert_allclose(policy(obs[i, 0]), wanted[i, 0], atol=1e-5)
    best = load_policy(folder)
    assert best.seed == 4 + int(np.argmax(about["returns"]))


def test_a_policy_plays_in_the_environment_of_its_training(run: tuple[Path, list]) -> None:
    policy = load_policy(run[0], 5)
    assert make_env(policy).observation_space.shape == (policy.about["num_obs"],)
    returns, demos = play(policy, 2, seed=3)
    assert len(demos) == 2 and demos.episode(0).states.shape == (201, 4)
    again, _ = play(policy, 2, seed=3)
    np.testing.assert_array_equal(returns, again)
    env = gymnasium.make("planspace/CartPoleSwingUp-v0")
    for i, total in enumerate(returns):  # the same actions from the same start have the same return
        env.reset(seed=3 + i)
        paid = [env.step(action.astype(np.float32))[1] for action in demos.episode(i).controls]
        assert sum(map(float, paid)) == pytest.approx(total, rel=1e-6)


def test_the_command_plays_and_films(
    embedding: Embedding, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    train_policies("cartpole", TrainConfig(num_seeds=2, steps=1), out=folder)
    assert main(["play", str(folder), "--seed", "1", "--episodes", "2"]) == 0
    said = capsys.readouterr().out
    assert "seed 1, 2 episodes of cartpole" in said and "return: mean" in said
    assert main(["play", str(folder), "--seed", "7"]) == 2
    assert "has seeds 0 to 1, not 7" in capsys.readouterr().err
    assert main(["play", str(folder), "--seed", "worst"]) == 2
    capsys.readouterr()
    for arm in ([], ["--arm", "raw"]):
        assert main(["play", str(tmp_path), *arm]) == 1
        assert "holds no policies" in capsys.readouterr().err


def test_loading_needs_neither_jax_nor_mujoco(tmp_path: Path) -> None:
    train_policies("cartpole", TrainConfig(num_seeds=1, steps=1), out=tmp_path / "run")
    code = "import sys, numpy, planspace; p = planspace.load_policy(sys.argv[1]); p(numpy.zeros(4)); "
    code += "print([m for m in ('jax', 'equinox', 'mujoco') if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "run")], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_wrong_observations_seeds_and_files_are_refused(tmp_path: Path) -> None:
    train_policies("cartpole", TrainConfig(num_seeds=1, steps=1), out=tmp_path / "run")
    policy = load_policy(tmp_path / "run")
    with pytest.raises(PlanspaceError, match="trained on observations of 4 numbers .*got 6"):
        policy(np.zeros(6, np.float32))
    with pytest.raises(UsageError, match="has seeds 0 to 0, not 3"):
        load_policy(tmp_path / "run", 3)
    weights = tmp_path / "run" / "policies.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1] + b"x")
    with pytest.raises(PlanspaceError, match="policies.safetensors"):
        load_policy(tmp_path / "run")


def test_actions_without_limits_are_saved_and_played(tmp_path: Path) -> None:
    train_policies("cartpole-swingup", TrainConfig(num_seeds=1, steps=1, reward="2020"), out=tmp_path)
    policy = load_policy(tmp_path)
    assert (policy.low, policy.high) == (-np.inf, np.inf)
    returns, demos = play(policy, 1, seed=0)
    assert np.isfinite(returns).all() and np.isfinite(demos.controls).all()


def test_an_action_that_is_not_finite_gives_a_one_line_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    train_policies("cartpole", TrainConfig(num_seeds=1, steps=1), out=tmp_path)
    policy = load_policy(tmp_path)
    for obs in (np.full(4, np.nan), np.full(4, 1e300)):
        with pytest.raises(PlanspaceError, match="an action of seed 0 is not finite"):
            policy(obs)
    weights, description = tmp_path / "policies.safetensors", tmp_path / "policies.json"
    arrays = {**read_arrays(weights), "2.weight": np.full((1, 1, 32), 3e38, np.float32)}
    write_sealed(description, read_sealed(description) | {"weights_sha256": write_arrays(weights, arrays)})
    capsys.readouterr()
    assert main(["play", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1 and "is not finite" in said.err
