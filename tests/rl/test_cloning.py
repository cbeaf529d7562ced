"""Policies that imitate plans before training, and under a penalty."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.random as jr
import numpy as np
import pytest

from planspace.cli.train import RECORDED
from planspace.demos.dataset import Demos
from planspace.envs.episodes import TaskEpisodes
from planspace.errors import UsageError
from planspace.rl import training
from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms.on_policy import OnPolicy
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.algorithms.sac import SAC
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.arm import Arm
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.policy_network import Actor
from planspace.rl.saved_settings import read_settings
from planspace.rl.training import train_policies
from planspace.rl.transitions import Transitions
from planspace.seams import plain_settings
from planspace.tasks.catalog import TASKS

from ..strangers.cross_entropy import CrossEntropy

TASK = TASKS["cartpole-swingup"]
GOLDEN_RUN = Path(__file__).parents[1] / "golden" / "2026-11-29" / "run"
SEEING = OnPolicy(normalise_obs=True, hidden=(16,))
ALGORITHMS = {
    "trpo": TRPO(SEEING),
    "ppo": PPO(SEEING, of_steps=True, minibatch=200, tolerance=0.0),
    "sac": SAC(normalise_obs=True, hidden=(16,), critic_hidden=(16,), batch=64, updates_per_step=0.25),
}


def make_arm(algorithm: Algorithm, **changes: Any) -> Arm:
    """The swing-up with two environments, and a control for each state: 2 tanh(x - theta)."""
    config = TrainConfig(algorithm, num_seeds=1, steps=800, batch_steps=400, **changes)
    states = np.random.default_rng(0).normal(size=(400, 4)).astype(np.float32)
    actions = 2.0 * np.tanh(states[:, :1] - states[:, 1:2])
    steps = Transitions(states, actions, np.zeros(400, np.float32), states, np.zeros(400, bool))
    episodes = TaskEpisodes(TASK, 2)
    return Arm(config, Observer(TASK, "raw", "none", "both"), episodes, plan_transitions=steps)


def error_of(arm: Arm, state: Any) -> float:
    """Mean squared difference of the mean actions from those of the plans."""
    steps = arm.plan_transitions
    assert steps is not None
    network = replace(arm.config.algorithm.act(arm, state), log_std=None)
    actions = Actor([network], arm.observer.policy_columns)(steps.obs[None], np.zeros((1, 400, 1)))
    return float(np.mean((actions[0] - steps.actions) ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_policy_imitates_plans_before_training_and_under_a_penalty(name: str) -> None:
    algorithm: Any = ALGORITHMS[name]
    cloning, arm = make_arm(algorithm, clone=1500), make_arm(algorithm, clone_weight=100.0)
    first = algorithm.init(arm, key=jr.key(0))
    cloned = algorithm.clone(cloning, first, key=jr.key(1))
    assert error_of(cloning, cloned) < 0.1 * error_of(cloning, first)
    rollout = algorithm.collect(arm, [first], [np.random.default_rng(0)]).of_seed(0)
    error = {
        done: error_of(arm, algorithm.update(arm.at(done), first, rollout, key=jr.key(2))[0])
        for done in (0.0, 0.5)  # the penalty has decreased to 0 after half of training
    }
    free = make_arm(algorithm)
    after = algorithm.update(free, first, rollout, key=jr.key(2))[0]
    assert error_of(free, after) == error[0.5] > error[0.0] + 0.02


@pytest.mark.parametrize("name", ALGORITHMS)
def test_observations_stay_standardised_as_those_of_the_plans(name: str) -> None:
    algorithm: Any = ALGORITHMS[name]
    arm = make_arm(algorithm, clone=1)
    assert arm.plan_transitions is not None
    cloned = algorithm.clone(arm, algorithm.init(arm, key=jr.key(0)), key=jr.key(1))
    np.testing.assert_allclose(cloned.statistics.mean, arm.plan_transitions.obs.mean(axis=0), atol=1e-6)
    rollout = algorithm.collect(arm, [cloned], [np.random.default_rng(0)]).of_seed(0)
    after = algorithm.update(arm, cloned, rollout, key=jr.key(2))[0]
    jax.tree.map(np.testing.assert_array_equal, after.statistics, cloned.statistics)


def test_the_penalty_decreases_linearly_to_0() -> None:
    arm = make_arm(TRPO(), clone_weight=8.0, clone_decay=0.5)
    assert [arm.at(done).clone_weight for done in (0.0, 0.125, 0.25, 0.5, 0.9)] == [8.0, 6.0, 4.0, 0.0, 0.0]


@pytest.mark.slow
def test_a_resumed_run_is_exact_with_every_use_of_plans(
    demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sac = replace(ALGORITHMS["sac"], updates_per_step=0.05)
    uses = {"clone": 20, "clone_weight": 2.0, "replay": 0.3, "resets": 0.6, "reset_schedule": "reverse"}
    config = TrainConfig(sac, num_seeds=2, steps=1200, batch_steps=400, eval_every=1, **uses)
    run = lambda out, config=config: train_policies(TASK, config, plans=demos, out=tmp_path / out)  # noqa: E731
    whole = run("whole").history
    monkeypatch.setattr(training, "CHECKPOINT_EVERY", 1)
    iterate, calls = training._iterate, []

    def interrupted(*args: Any) -> Any:
        calls.append(None)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return iterate(*args)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(training, "_iterate", interrupted)
        run("cut")
    resumed, alone = run("cut").history, run("alone", replace(config, seed=1, num_seeds=1)).history
    for name in whole.keys() - {"steps", "eval_steps"}:
        np.testing.assert_array_equal(whole[name], resumed[name])
        np.testing.assert_array_equal(whole[name][:, 1], alone[name][:, 0])


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "steps": ({"clone": -1}, "`clone` must be at least 0, got -1"),
    "weight": ({"clone_weight": float("inf")}, "`clone_weight` must be at least 0 and finite, got inf"),
    "decay": ({"clone_decay": 0.0}, "`clone_decay` must be above 0 and at most 1"),
    "states": ({"reset_states": "trees"}, "reset_states is 'trees', but no episode starts at plans"),
    "curriculum": ({"resets": 0.5, "reset_states": "both", "reset_schedule": "reverse"}, "needs states of"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_settings_that_do_not_fit_are_refused(case: str) -> None:
    changes, message = REFUSED[case]
    with pytest.raises(UsageError, match=message):
        TrainConfig(**changes)


def test_an_algorithm_that_cannot_imitate_and_plans_without_controls_are_refused(demos: Demos) -> None:
    with pytest.raises(UsageError, match="--clone 5 needs an algorithm that can imitate plans, but cross"):
        train_policies(TASK, TrainConfig(CrossEntropy(), clone=5), plans=demos)
    with pytest.raises(UsageError, match="--clone-weight needs the controls of the plans"):
        without = replace(demos, controls=np.zeros_like(demos.controls))
        train_policies(TASK, TrainConfig(clone_weight=1.0), plans=without)


def test_a_run_of_an_earlier_version_resumes_with_the_same_settings() -> None:
    saved = json.loads((GOLDEN_RUN / "config.json").read_text())
    now = plain_settings(read_settings(saved)[1])
    assert now == {name: saved[name] for name in now}
    assert set(saved) - set(now) <= set(RECORDED)
