"""Evaluations, and interrupts at any moment of training."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from planspace import load_policy
from planspace.envs.episodes import TaskEpisodes
from planspace.rl import training
from planspace.rl.arm import Arm
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.rl.evaluation import Evaluation, evaluate
from planspace.rl.observe import Observer
from planspace.rl.training import train_policies
from planspace.storage.arrays import read_arrays_and_metadata
from planspace.storage.checkpoint import FILE
from planspace.tasks.catalog import TASKS

TASK = "cartpole-swingup"
CONFIG = TrainConfig(num_seeds=2, steps=3 * BATCH_STEPS)


@pytest.mark.slow
def test_interrupted_training_gives_the_same_result_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = train_policies(TASK, CONFIG).history
    iterate, calls = training._iterate, []

    def interrupted(*args: Any) -> Any:
        calls.append(args[-1])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return iterate(*args)

    monkeypatch.setattr(training, "_iterate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train_policies(TASK, CONFIG, out=tmp_path / "cut")
    cut = train_policies(TASK, CONFIG, out=tmp_path / "cut").history
    assert calls == [0, 1, 2, 2]  # only the interrupted iteration is repeated
    for key, expected in whole.items():
        np.testing.assert_array_equal(expected, cut[key])
    assert len((tmp_path / "cut" / "log.jsonl").read_text().splitlines()) == 3


@pytest.mark.parametrize("name", ["append_rows", "save_checkpoint"])
def test_an_interrupt_while_saving_does_not_duplicate_rows(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work, interrupts = getattr(training, name), []

    def interrupted(*args: object, **options: object) -> None:
        work(*args, **options)
        if not interrupts:
            interrupts.append(KeyboardInterrupt())
            raise interrupts[0]

    monkeypatch.setattr(training, "CHECKPOINT_EVERY", 1)
    monkeypatch.setattr(training, name, interrupted)
    with pytest.raises(KeyboardInterrupt):
        train_policies(TASK, CONFIG, out=tmp_path)
    assert read_arrays_and_metadata(tmp_path / FILE)[1]["iteration"] == 1  # finished work is not lost
    train_policies(TASK, CONFIG, out=tmp_path)
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [row["iteration"] for row in rows] == [1, 2, 3]


@pytest.mark.slow
def test_evaluations_do_not_change_training() -> None:
    config = replace(CONFIG, steps=5 * BATCH_STEPS)
    often = train_policies(TASK, replace(config, eval_every=2)).history
    assert often["eval_steps"].tolist() == [2 * BATCH_STEPS, 4 * BATCH_STEPS, 5 * BATCH_STEPS]
    assert np.isfinite(often["eval_return"]).all()
    never = train_policies(TASK, replace(config, eval_every=0)).history
    assert never["eval_steps"].tolist() == [5 * BATCH_STEPS]
    for key in often.keys() - {"eval_steps", "eval_return", "eval_success"}:
        np.testing.assert_array_equal(often[key], never[key])
    np.testing.assert_array_equal(often["eval_return"][-1], never["eval_return"][-1])


@pytest.mark.slow
def test_an_interrupted_evaluation_is_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(CONFIG, eval_every=2)
    whole = train_policies(TASK, config).history
    evaluate, calls = training._evaluate, []

    def interrupted(*args: Any) -> Any:
        calls.append(args[-1])
        if len(calls) in (1, 3):
            raise KeyboardInterrupt
        return evaluate(*args)

    monkeypatch.setattr(training, "_evaluate", interrupted)
    for _ in range(2):  # interrupt the first evaluation, then the last
        with pytest.raises(KeyboardInterrupt):
            train_policies(TASK, config, out=tmp_path / "cut")
    cut = train_policies(TASK, config, out=tmp_path / "cut").history
    assert calls == [0, 0, 1, 1]
    for key, expected in whole.items():
        np.testing.assert_array_equal(expected, cut[key])


def test_an_evaluation_ignores_exploration_and_is_the_same_for_every_seed() -> None:
    observer = Observer(TASKS[TASK], "raw", "none", "both", num_seeds=2)
    arm = Arm(CONFIG, observer, TaskEpisodes(observer.task, 2 * 20))
    with ThreadPoolExecutor(1) as threads:
        run = training._Training(arm, threads)
        state = training._init(run)
        first = state.agents[0]
        wild = eqx.tree_at(lambda x: x.policy.log_std, first, jnp.full(1, 2.0))
        state = state._replace(agents=(first, wild))  # the same mean, another standard deviation
        returns = training._evaluate(run, state, 0).history[training.EVALUATION][0]
    assert returns[0] == returns[1]


def test_an_evaluation_that_is_not_finite_is_saved_as_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = Evaluation(np.array([np.nan, -3.0]), np.array([0.0, 0.5]))
    monkeypatch.setattr(training, "evaluate", lambda *_: found)
    train_policies(TASK, replace(CONFIG, steps=1), out=tmp_path / "run")
    policy = load_policy(tmp_path / "run")
    assert policy.about["returns"] == [None, -3.0] and policy.seed == 1


def test_success_is_the_fraction_of_first_episodes_that_end_at_the_goal() -> None:
    """Idle: the pole falls in some episodes, whose environments then begin other ones."""
    task = TASKS["cartpole"]
    observer, num = Observer(task, "raw", "none", "both", num_seeds=2), 10
    episodes = TaskEpisodes(task, 2 * num)
    idle = lambda obs, noise: np.zeros_like(noise)  # noqa: E731
    found = evaluate(episodes, observer, idle, 2)
    assert found.success is not None
    assert found.success.tolist() == [0.0, 0.0] and (found.returns < 100).all()
    anywhere = replace(task, at_goal=lambda states, target: states[:, 0] > 0, terminated=fallen_or_right)
    ends = evaluate(
        TaskEpisodes(anywhere, 2 * num), Observer(anywhere, "raw", "none", "both", num_seeds=2), idle, 2
    )
    assert ends.success is not None
    assert 0 < ends.success[0] < 1 and ends.success[0] == ends.success[1]


def fallen_or_right(states: np.ndarray) -> np.ndarray:
    return np.abs(states[:, 1]) > 0.2


def test_a_run_that_was_begun_without_success_continues_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "CHECKPOINT_EVERY", 1)
    iterate = training._iterate

    def interrupted(*args: Any) -> Any:
        if args[-1] == 2:
            raise KeyboardInterrupt
        return iterate(*args)

    with monkeypatch.context() as patch:
        patch.setattr(training, "EVALUATED", ("eval_return",))  # as a version without success began it
        patch.setattr(training, "_iterate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train_policies(TASK, CONFIG, out=tmp_path / "run")
    continued = train_policies(TASK, CONFIG, out=tmp_path / "run").history
    whole = train_policies(TASK, CONFIG).history
    assert "eval_success" not in continued and whole["eval_success"].shape == (1, 2)
    for name in whole.keys() - {"eval_success"}:
        np.testing.assert_array_equal(whole[name], continued[name])
