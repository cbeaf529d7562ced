"""An algorithm that planspace does not ship is used like a shipped one."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace import load_policy
from planspace.errors import PlanspaceError, UsageError
from planspace.rl.algorithm import Diverged
from planspace.rl.config import TrainConfig
from planspace.rl.play import play
from planspace.rl.policy_network import PolicyNetwork
from planspace.rl.saved_settings import read_settings
from planspace.rl.training import train_policies
from planspace.tasks.catalog import TASKS
from planspace.tasks.task import Task, never

from ..strangers.cross_entropy import CrossEntropy

SHORT = TrainConfig(CrossEntropy(), num_seeds=2, steps=3000, batch_steps=1000)


def aim() -> Task:
    """The reward of each step is -(control - 1)^2: the best action is always 1, the best return 0."""
    return replace(
        TASKS["cartpole"],
        name="aim",
        horizon=20,
        start_low=(-1.0, -1.0, 0.0, 0.0),
        start_high=(1.0, 1.0, 0.0, 0.0),
        reward=lambda before, after, control, target: -((control[:, 0] - 1.0) ** 2),
        terminated=never,
    )


@pytest.mark.nightly
def test_an_own_algorithm_and_trpo_find_the_known_best_action() -> None:
    config = TrainConfig(num_seeds=2, steps=100_000)
    for algorithm in (CrossEntropy(), "trpo"):
        trained = train_policies(aim(), config, algorithm=algorithm)
        for seed in (0, 1):
            actions = trained.policy(seed)(np.zeros((1, 4), np.float32))
            np.testing.assert_allclose(actions, 1.0, atol=0.2)
        assert all(row.evaluation > -1.0 for row in trained.returns)


@pytest.mark.slow
def test_an_own_algorithm_is_saved_resumed_and_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = train_policies("cartpole", SHORT, out=tmp_path / "whole")
    assert whole.history["return"].shape == whole.history["std"].shape == (3, 2)
    update, calls = CrossEntropy.update, []

    def interrupted(self: CrossEntropy, *args: Any, **options: Any) -> Any:
        calls.append(None)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return update(self, *args, **options)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(CrossEntropy, "update", interrupted)
        train_policies("cartpole", SHORT, out=tmp_path / "cut")
    cut = train_policies("cartpole", SHORT, out=tmp_path / "cut")
    for name, numbers in whole.history.items():
        np.testing.assert_array_equal(numbers, cut.history[name])
    alone = train_policies("cartpole", replace(SHORT, seed=1, num_seeds=1)).history
    np.testing.assert_array_equal(whole.history["return"][:, 1], alone["return"][:, 0])

    policy = load_policy(tmp_path / "whole", 1)
    assert (policy.std == 0).all()
    returns, _ = play(policy, 2, seed=0)
    assert len(returns) == 2
    saved = json.loads((tmp_path / "whole" / "config.json").read_text())
    assert saved["algorithm"]["name"] == "cross-entropy" and "source_sha256" in saved["algorithm"]
    assert read_settings(saved, CrossEntropy()) == ("cartpole", SHORT)
    with pytest.raises(UsageError, match="'cross-entropy', which planspace does not ship"):
        read_settings(saved)
    with pytest.raises(PlanspaceError, match=r"algorithm\.elite was 0\.3, now 0\.5"):
        train_policies("cartpole", SHORT, algorithm=CrossEntropy(elite=0.5), out=tmp_path / "whole")


def test_an_own_task_is_identified_by_its_content(tmp_path: Path) -> None:
    config = replace(SHORT, steps=1)
    train_policies(aim(), config, out=tmp_path)
    policy = load_policy(tmp_path)
    assert policy.about["task"] == "aim" and policy.about["env_id"] is None
    with pytest.raises(UsageError, match="was trained on 'aim', a task of your own: pass the task"):
        play(policy, 1, seed=0)
    with pytest.raises(UsageError, match="was trained on the task 'aim', got 'cartpole'"):
        play(policy, 1, seed=0, task=TASKS["cartpole"])
    returns, demos = play(policy, 2, seed=0, task=aim())
    assert len(demos) == 2 and (returns <= 0).all()
    with pytest.raises(PlanspaceError, match="task_sha256 has changed"):
        train_policies(replace(aim(), frame_skip=3), config, out=tmp_path)


@dataclass(frozen=True)
class Invalid(CrossEntropy):
    """Changes what one method returns."""

    method: str = ""
    result: Any = None

    def __getattribute__(self, name: str) -> Any:
        own = object.__getattribute__(self, "__dict__")
        if name == own.get("method"):
            return lambda *args, **options: own["result"](getattr(CrossEntropy, name)(self, *args, **options))
        return object.__getattribute__(self, name)


INVALID: dict[str, tuple[str, Any, str]] = {
    "a plain number": (
        "init",
        lambda s: {**s, "best": 1.0},
        r"init must return arrays only.*1\.0 at \['best'\]",
    ),
    "infinity": ("init", lambda s: {**s, "best": np.array(np.inf)}, "init must return finite numbers"),
    "no rollout": ("collect", lambda r: None, "collect must return a Rollout.*got None"),
    "one seed": (
        "collect",
        lambda r: r.of_seed(0),
        r"collect must return rewards .*\(2, 10\); got \(10,\)",
    ),
    "no numbers": ("update", lambda x: x[0], "update must return a state and a mapping"),
    "another structure": ("update", lambda x: ({}, x[1]), "update must return a state of the structure"),
    "another shape": (
        "update",
        lambda x: ({**x[0], "mean": np.zeros(3)}, x[1]),
        r"update must return \['mean'\] with shape \(49,\) and type float32, as `init` did; got shape \(3,\)",
    ),
    "a list of numbers": (
        "update",
        lambda x: (x[0], {"std": [1, 2]}),
        "must return single numbers",
    ),
    "a taken name": ("update", lambda x: (x[0], {"return": 1.0}), "does not use itself; got return"),
    "no network": ("act", lambda n: n.weights, "act must return a PolicyNetwork"),
    "another size": (
        "act",
        lambda n: PolicyNetwork(n.weights[:1], n.biases[:1]),
        r"act must return weights .* from 4 observed numbers to 1 actions; got .* \[\(8, 4\)\]",
    ),
}


@pytest.mark.parametrize("case", INVALID)
def test_invalid_results_of_an_algorithm_are_refused(case: str) -> None:
    method, result, message = INVALID[case]
    config = TrainConfig(Invalid(method=method, result=result), num_seeds=2, steps=1, batch_steps=1000)
    with pytest.raises(UsageError, match=message) as caught:
        train_policies("cartpole", config)
    assert "See docs/howto/own-algorithm.md." in str(caught.value)


def test_a_class_instead_of_an_instance_is_refused() -> None:
    with pytest.raises(UsageError, match="got the class CrossEntropy: pass an instance"):
        train_policies("cartpole", algorithm=CrossEntropy)  # pyright: ignore


def test_an_algorithm_can_raise_diverged_for_a_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    update, calls = CrossEntropy.update, []

    def diverging(self: CrossEntropy, arm: Any, state: Any, rollout: Any, *, key: Any) -> Any:
        calls.append(None)
        if len(calls) == 1:
            raise Diverged
        return update(self, arm, state, rollout, key=key)

    monkeypatch.setattr(CrossEntropy, "update", diverging)
    history = train_policies("cartpole", replace(SHORT, num_seeds=1)).history
    assert history["frozen"].tolist() == [[1.0]] * 3 and len(calls) == 1
    assert "std" not in history and np.isfinite(history["return"]).all()
