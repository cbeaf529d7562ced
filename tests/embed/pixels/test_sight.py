"""Episodes seen through pictures: what an encoder reads, controllers, and policies."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import planspace
from planspace import ControlConfig, Embedding
from planspace.cli import main
from planspace.control.plant import Plant
from planspace.control.runs import EPISODES, control_into
from planspace.demos.load import load_demos
from planspace.embed.pixels.sight import Sight
from planspace.errors import UsageError
from planspace.rl.pixels import PixelObservations
from planspace.rl.play import play
from planspace.rl.saved_policy import load_policy
from planspace.tasks.catalog import find_task

from .untrained import PICTURES, untrained

PUSH = np.full(1, 3.0)


def test_an_episode_looks_as_the_environment_shows_it(opengl: str, embedding: Embedding) -> None:
    task, encoder = find_task("cartpole-swingup"), untrained(embedding)
    sight = Sight(encoder, *task.compile(), 0.04)
    env = planspace.make_env(task, obs="pixels", pictures=PICTURES)
    for seed in (0, 1):
        sight.restart(np.random.default_rng(0))
        obs, info = env.reset(seed=seed)
        for _ in range(3):
            z, state = sight.see(info["state"])
            np.testing.assert_array_equal(z, encoder.encode(obs))
            np.testing.assert_array_equal(state, encoder.states(obs))
            obs, _, _, _, info = env.step(PUSH)
    sight.close(), env.close()


class Halving:
    """A filter that halves each estimate, and remembers the controls."""

    def __init__(self) -> None:
        self.controls: list[np.ndarray] = []

    def __call__(self, estimate: np.ndarray) -> np.ndarray:
        return estimate / 2

    def predict(self, control: np.ndarray) -> None:
        self.controls.append(control)


def test_with_a_filter_z_is_that_of_the_filtered_state(opengl: str, embedding: Embedding) -> None:
    encoder, state = untrained(embedding), np.array([0.1, 0.2, 0.3, 0.4])
    sight = Sight(encoder, *find_task("cartpole-swingup").compile(), 0.04)
    sight.restart(np.random.default_rng(0))
    estimate = sight.see(state)[1]
    half = Halving()
    sight.restart(np.random.default_rng(0), half)
    z, seen = sight.see(state)
    np.testing.assert_array_equal(seen, estimate / 2)
    np.testing.assert_array_equal(z, embedding.encode(estimate / 2))
    sight.applied(PUSH)
    np.testing.assert_array_equal(half.controls, [PUSH])


def test_strange_pictures_are_said(opengl: str, embedding: Embedding) -> None:
    sight = Sight(untrained(embedding, strict=True), *find_task("cartpole-swingup").compile(), 0.04)
    with pytest.warns(UserWarning, match="does not look like those of the training: distance"):
        sight.see(np.zeros(4))


def test_a_controller_sees_only_pictures(opengl: str, embedding: Embedding, tmp_path: Path) -> None:
    plant, encoder = Plant.find("cartpole-swingup"), untrained(embedding)
    config = ControlConfig(samples=4, horizon_s=0.08)
    run = {"num": 1, "seed": 0, "episode_s": 0.12, "workers": 0}
    control_into(plant, embedding, config, tmp_path / "pixels", **run, encoder=encoder)
    control_into(plant, embedding, config, tmp_path / "states", **run)
    found, known = (load_demos(tmp_path / name / EPISODES) for name in ("pixels", "states"))
    np.testing.assert_array_equal(found.states[0], known.states[0])
    assert (found.controls != known.controls).any()
    assert json.loads((tmp_path / "pixels" / "config.json").read_text())["pixels"] == encoder.hash
    with pytest.raises(UsageError, match=r"frames 0.08 s apart, but the control step is 0.04 s: train"):
        slow = replace(encoder, frame_s=0.08)
        control_into(plant, embedding, config, tmp_path / "slow", **run, encoder=slow)


def test_a_policy_sees_only_pictures(opengl: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policy = load_policy("cartpole-swingup")
    teacher = planspace.load_embedding("cartpole-swingup")
    encoder = untrained(teacher)
    returns, seen = play(policy, 1, 7, encoder=encoder)
    _, known = play(policy, 1, 7)
    np.testing.assert_array_equal(seen.states[0], known.states[0])
    assert returns.shape == (1,) and (seen.controls != known.controls).any()
    encoder.save(tmp_path / "encoder")
    assert main(["play", "cartpole-swingup", "--pixels", str(tmp_path / "encoder"), "--episodes", "1"]) == 0
    assert "1 episode of cartpole-swingup" in capsys.readouterr().out


def test_what_a_policy_sees_is_filtered_if_errors_are_known(
    opengl: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, made = load_policy("cartpole-swingup"), list[tuple[tuple, Halving]]()

    def make_filter(*arguments: object) -> Halving:
        made.append((arguments, Halving()))
        return made[-1][1]

    monkeypatch.setattr("planspace.rl.pixels.StateFilter", make_filter)
    encoder = untrained(planspace.load_embedding("cartpole-swingup"))
    _, unfiltered = play(policy, 1, 7, encoder=encoder)
    assert made == []
    _, seen = play(policy, 2, 7, encoder=replace(encoder, state_error=np.arange(4.0)))
    assert (seen.controls[:20] != unfiltered.controls[:20]).any()
    for i, ((_, _, num_steps, errors), state_filter) in enumerate(made):
        assert num_steps == find_task("cartpole-swingup").frame_skip
        np.testing.assert_array_equal(errors, np.arange(4.0))
        np.testing.assert_array_equal(state_filter.controls, seen.episode(i).controls)
    assert len(made) == 2


def test_another_teacher_serves_only_a_policy_that_sees_filtered_states(
    opengl: str, embedding: Embedding, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, own = load_policy("cartpole-swingup"), planspace.load_embedding("cartpole-swingup")
    encoder, filtered = untrained(embedding), np.array([0.5, 2.0, -1.0, 3.0])
    with pytest.raises(UsageError, match="another embedding than the teacher of the encoder"):
        play(policy, 1, 0, encoder=encoder)
    monkeypatch.setattr("planspace.rl.pixels.StateFilter", lambda *_: lambda estimate: filtered)
    task = find_task("cartpole-swingup")
    observe = PixelObservations(policy, task, replace(encoder, state_error=np.ones(4)))
    observe.restart(0)
    seen = observe(np.zeros(4), SimpleNamespace(target=np.zeros(0)))
    np.testing.assert_allclose(seen[-own.z_dim :], own.encode(filtered), rtol=1e-5)
