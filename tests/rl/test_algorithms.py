import json
import re
from pathlib import Path
from typing import Any

import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms import ALGORITHMS, PRESETS, find_algorithm
from planspace.rl.algorithms.on_policy import MODERN, OnPolicy
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.algorithms.sac import SAC
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.config import TrainConfig
from planspace.rl.saved_settings import read_settings
from planspace.rl.training import train_policies
from planspace.seams import with_settings

GOLDEN = Path(__file__).parents[1] / "golden" / "2026-11" / "run"


def test_the_shipped_algorithms_fit_the_protocol() -> None:
    for (name, _), algorithm in PRESETS.items():
        assert isinstance(algorithm, Algorithm) and algorithm.name == name  # pyright: ignore
    assert {
        "trpo": TRPO(),
        "ppo": PPO(),
        "sac": SAC(),
    } == ALGORITHMS  # the defaults of a class are the preset `paper`


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UsageError, match="unknown algorithm 'tpro'. Did you mean 'trpo'?"):
        find_algorithm("tpro")
    with pytest.raises(UsageError, match="unknown preset of ppo 'old'.* Known: modern, paper"):
        find_algorithm("ppo", "old")
    with pytest.raises(UsageError, match="unknown setting 'lam'"):
        with_settings(TRPO(), lam=0.9)


def test_nested_hyperparameters_are_changed_by_name() -> None:
    changed = with_settings(TRPO(), gae_lambda=0.9, max_kl=0.5)
    assert changed == TRPO(OnPolicy(gae_lambda=0.9), max_kl=0.5)
    assert TrainConfig().with_hyperparameters(gae_lambda=0.9).algorithm == TRPO(OnPolicy(gae_lambda=0.9))


@pytest.mark.parametrize("algorithm", PRESETS.values(), ids=map("-".join, PRESETS))
def test_settings_are_read_from_a_saved_run(algorithm: Algorithm, tmp_path: Path) -> None:
    config = TrainConfig(algorithm, obs="trig", steps=1, num_seeds=1, seed=7, batch_steps=100)
    train_policies("cartpole", config, out=tmp_path)
    assert read_settings(json.loads((tmp_path / "config.json").read_text())) == ("cartpole", config)


def test_settings_of_version_0_1_0_are_read() -> None:
    saved = json.loads((GOLDEN / "config.json").read_text())
    assert read_settings(saved) == ("cartpole", TrainConfig(z="augment", steps=8000, num_seeds=2))
    learner = saved["learner"] | {"gae_lambda": 0.95, "critic": "mlp", "normalise_obs": True}
    learner |= {"bootstrap_timeout": True, "trpo": saved["learner"]["trpo"] | {"max_kl": 0.02}}
    modern = saved | {"preset": "modern", "learner": learner}
    assert read_settings(modern)[1].algorithm == TRPO(MODERN, max_kl=0.02)
    ppo = {"epochs": 3, "clip": 0.1, "of_steps": True}
    other = saved | {"algo": "ppo", "learner": {"trace": 0.5, "hidden": [8], "ppo": ppo}}
    expected = with_settings(PPO(), gae_lambda=0.5, hidden=(8,), **ppo)
    assert read_settings(other)[1].algorithm == expected


@pytest.mark.parametrize(
    ("preset", "change", "message"),
    [
        (("trpo", "paper"), {"discount": 5.0}, "`discount` must be between 0 and 1, got 5.0."),
        (("trpo", "paper"), {"entropy_reward": -1.0}, "`entropy_reward` must be at least 0 and finite"),
        (("ppo", "modern"), {"initial_std": 0.0}, "`initial_std` must be above 0 and finite"),
        (("trpo", "paper"), {"max_kl": 0.0}, "`max_kl` must be above 0 and finite, got 0.0."),
        (("trpo", "paper"), {"backtrack_ratio": 1.0}, "`backtrack_ratio` must be above 0 and below 1"),
        (("ppo", "paper"), {"gae_lambda": -0.1}, "`gae_lambda` must be between 0 and 1, got -0.1."),
        (("ppo", "modern"), {"clip": float("nan")}, "`clip` must be above 0 and finite, got nan."),
        (("ppo", "modern"), {"minibatch": 0}, "`minibatch` must be at least 1, got 0."),
        (("sac", "paper"), {"polyak": 0.0}, "`polyak` must be above 0 and at most 1, got 0.0."),
        (("sac", "paper"), {"learning_starts": -1}, "`learning_starts` must be at least 0, got -1."),
        (("sac", "paper"), {"hidden": ()}, "`hidden` needs at least one unit in each layer, got ()."),
        (("sac", "modern"), {"updates_per_step": 0.0}, "`updates_per_step` must be above 0 and finite"),
    ],
)
def test_hyperparameters_out_of_range_are_refused(
    preset: tuple[str, str], change: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        with_settings(PRESETS[preset], **change)


def test_unknown_and_incomplete_settings_are_refused() -> None:
    saved = json.loads((GOLDEN / "config.json").read_text())
    with pytest.raises(UsageError, match="unknown algorithm 'td3'"):
        read_settings(saved | {"algo": "td3"})
    with pytest.raises(UsageError, match="trained by 'mine:CEM', which planspace does not ship"):
        read_settings({"task": "cartpole", "algorithm": {"name": "mine:CEM"}})
    for broken in ({}, {"task": "cartpole"}, {"task": "cartpole", "algorithm": 3}):
        with pytest.raises(PlanspaceError, match="not the settings of a training run"):
            read_settings(broken)
