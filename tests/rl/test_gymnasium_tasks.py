"""Gymnasium environments as tasks: `gym:ID` and `GymTask`."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

import planspace as ps
from planspace.cli import main
from planspace.embed.embedding import Embedding
from planspace.envs.episodes import Episodes, GymEpisodes, TaskEpisodes, make_episodes
from planspace.errors import PlanspaceError, UsageError
from planspace.rl import training
from planspace.rl.config import TrainConfig
from planspace.rl.evaluation import EVALUATION_SEED
from planspace.rl.observe import Observer
from planspace.rl.play import make_env, play
from planspace.rl.rollout import collect
from planspace.rl.training import train_policies
from planspace.tasks.catalog import TASKS
from planspace.tasks.env_state import state_reader
from planspace.tasks.gymnasium import GymTask

from . import tiny_gym_envs

PUCK = GymTask("tiny/Puck-v0")
PENDULUM = "gym:InvertedPendulum-v5"
CONFIG = TrainConfig(num_seeds=2, steps=600, batch_steps=100)


# --- stepping ---------------------------------------------------------------------------------------


def test_a_planspace_task_through_gymnasium_gives_the_same_episodes(rng: np.random.Generator) -> None:
    """The second path makes 3 environments with `gymnasium.make` and steps each of them by itself."""
    own = TASKS["cartpole"]  # its episodes end early
    task = GymTask("planspace/CartPole-v0")
    assert task.horizon == own.horizon and task.state_names == (
        *[f"obs_{i}" for i in range(4)],
        *own.state_names,
    )
    direct, through = TaskEpisodes(own, 3), make_episodes(task, 3)
    assert isinstance(through, GymEpisodes) and isinstance(through, Episodes)
    np.testing.assert_array_equal(direct.action_limits, through.action_limits)
    through.reset([np.random.default_rng(5)])
    direct.batch.reset(through.states[:, 4:], np.zeros((3, 0)))
    for _ in range(own.horizon):
        actions = rng.normal(0, 3, (3, 1)).astype(np.float32).astype(float)  # beyond the limits of 3, too
        a, b = direct.step(actions), through.step(actions)
        for x, y in zip(a, b, strict=True):
            np.testing.assert_array_equal(x, y)
        np.testing.assert_array_equal(direct.states, through.states[:, 4:])
        observed = Observer(own, "raw", "none", "both")(direct.states, direct.targets)
        np.testing.assert_array_equal(
            observed, Observer(task, "raw", "none", "both")(through.states, through.targets)
        )
        if a.terminated.any():
            break
    assert a.terminated.any()


def test_terminated_timeout_and_cut_are_distinguished() -> None:
    episodes = make_episodes(replace(PUCK, max_episode_steps=30), 4)
    observer = Observer(episodes.task, "raw", "none", "both")
    rngs = [np.random.default_rng(s) for s in (0, 1)]
    rollout = collect(episodes, observer, lambda obs, noise: np.where(obs[..., 1:2] < 0, -9.0, 9.0), 70, rngs)
    assert rollout.terminated.any() and rollout.timeout.any()
    assert not (rollout.terminated & rollout.timeout).any() and not rollout.cut[:-1].any()
    ended = rollout.terminated | rollout.timeout
    assert (rollout.cut[-1] == ~ended[-1]).all()
    assert (rollout.step[1:][ended[:-1]] == 0).all() and rollout.step.max() == 29
    np.testing.assert_allclose(rollout.rewards, -np.abs(rollout.next_obs[..., 1]), rtol=1e-6)
    assert (np.abs(rollout.actions) == 9).all()  # recorded as the policy chose them, clipped when applied


def test_an_action_that_is_not_finite_cuts_its_episode_only() -> None:
    episodes = make_episodes(PUCK, 2)
    episodes.reset([np.random.default_rng(0)])
    before = episodes.states
    steps = episodes.step(np.array([[np.nan], [1.0]]))
    assert steps.cut.tolist() == [True, False] and steps.rewards[0] == 0
    np.testing.assert_array_equal(before[0], episodes.states[0])
    assert (before[1] != episodes.states[1]).any()


def test_a_dictionary_is_flattened_with_names() -> None:
    assert PUCK.state_names == ("last_0", "puck_0", "puck_1")  # Gymnasium sorts the keys
    named = replace(PUCK, obs_names=("push", "x", "v"))
    assert list(named.fields("raw")) == ["push", "x", "v"]
    env = ps.make_env(named)
    obs, info = env.reset(seed=3)
    inner: Any = env.unwrapped
    np.testing.assert_allclose(obs, [0, inner.inner.unwrapped.x, inner.inner.unwrapped.v], rtol=1e-6)
    assert obs.dtype == np.float32 and info["state"].shape == (3,)
    many = ps.make_env(PUCK, 3)
    assert many.reset(seed=3)[0].shape == (3, 3)


# --- training ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("z", [False, True])
def test_a_seed_does_not_depend_on_the_other_seeds(z: bool, embedding: Embedding) -> None:
    """With z: the embedding finds the joints of InvertedPendulum, which are called as ours."""
    config = replace(CONFIG, z="augment") if z else CONFIG
    task = GymTask("InvertedPendulum-v5", max_episode_steps=50) if z else PUCK
    config = replace(config, num_seeds=3, steps=300)
    given = embedding if z else None
    together = train_policies(task, config, embedding=given).history
    single = train_policies(task, replace(config, seed=2, num_seeds=1), embedding=given).history
    for key in together.keys() - {"steps", "eval_steps"}:
        np.testing.assert_array_equal(together[key][:, 2], single[key][:, 0])  # bit for bit
    assert (together["return"][:, 1] != together["return"][:, 2]).all()


def test_workers_give_the_same_results_bit_for_bit(tmp_path: Path) -> None:
    """Five environments in three workers; the run does not record the workers, so it is found again."""
    class_of_a_script = type("Sliding", (tiny_gym_envs.Puck,), {"__module__": "__main__"})
    gymnasium.register("tiny/Sliding-v0", class_of_a_script, max_episode_steps=20)  # unknown to a worker
    task, config = GymTask("tiny/Sliding-v0"), replace(CONFIG, num_seeds=1, steps=200)
    one = train_policies(task, config, out=tmp_path / "one")
    several = train_policies(task, config, env_workers=3, out=tmp_path / "several")
    assert one.history["return"].std() > 0
    for key, numbers in one.history.items():
        np.testing.assert_array_equal(several.history[key], numbers)
    assert (tmp_path / "one/config.json").read_bytes() == (tmp_path / "several/config.json").read_bytes()


def test_a_worker_that_dies_ends_training_with_its_exit_code() -> None:
    with pytest.raises(PlanspaceError, match=r"worker process .* ended unexpectedly \(exit code 7\)"):
        train_policies(replace(PUCK, kwargs={"broken": "exit"}), CONFIG, env_workers=2)


def test_an_embedding_must_find_its_inputs(embedding: Embedding) -> None:
    message = r"task gym:tiny/Puck-v0: the embedding reads .* these have 3 \(last_0, puck_0, puck_1\)"
    with pytest.raises(UsageError, match=message):
        train_policies(PUCK, replace(CONFIG, z="augment"), embedding=embedding)
    renamed = replace(PUCK, obs_names=("hinge", "slider", "slidervel"))
    with pytest.raises(UsageError, match="'hingevel' is missing"):
        train_policies(renamed, replace(CONFIG, z="augment"), embedding=embedding)


def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = train_policies(PUCK, CONFIG, out=tmp_path / "whole").history
    iterate, calls = training._iterate, []

    def interrupted(*args: Any) -> Any:
        calls.append(None)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return iterate(*args)

    with monkeypatch.context() as patch:
        patch.setattr(training, "_iterate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train_policies(PUCK, CONFIG, out=tmp_path / "run")
    resumed = train_policies(PUCK, CONFIG, out=tmp_path / "run").history
    assert len(calls) == 4
    for key, numbers in whole.items():
        np.testing.assert_array_equal(resumed[key], numbers)


def test_a_run_records_its_environment_and_its_policies_play(tmp_path: Path) -> None:
    task = replace(PUCK, kwargs={"push": 2.0})
    run = train_policies("gym:tiny/Puck-v0", CONFIG, out=tmp_path / "run").run
    settings = json.loads((run / "config.json").read_text())
    assert settings["task"] == "gym:tiny/Puck-v0"
    assert settings["environment"] == {
        "id": "tiny/Puck-v0",
        "kwargs": {},
        "max_episode_steps": None,
        "obs_names": [],
    }
    assert settings["versions"]["gymnasium"] == gymnasium.__version__
    with pytest.raises(PlanspaceError, match=r"environment\.kwargs\.push was not set, now 2\.0"):
        train_policies(task, CONFIG, out=run)
    policy = ps.load_policy(run)
    with pytest.raises(PlanspaceError, match="cannot start an episode at a given state"):
        play(policy, 1, 0, starts=np.zeros((1, 2)))
    returns, demos = play(policy, 3, 7)
    assert repr(PUCK) == "GymTask('tiny/Puck-v0')" and repr(task) == "GymTask('tiny/Puck-v0', {'push': 2.0})"
    assert demos.info.names == PUCK.state_names and (np.diff(demos.offsets) == 21).all()
    np.testing.assert_allclose(returns[0], -np.abs(demos.episode(0).states[1:, 1]).sum(), rtol=1e-6)
    np.testing.assert_allclose(np.diff(demos.episode(0).times), 0.05)
    with pytest.raises(UsageError, match="was trained on another version of the task 'gym:tiny/Puck-v0'"):
        make_env(policy, task)
    with pytest.raises(UsageError, match="was trained on the task 'gym:tiny/Puck-v0', got 'cartpole'"):
        make_env(policy, TASKS["cartpole"])


def test_evaluation_returns_are_those_of_play(tmp_path: Path) -> None:
    task = GymTask("tiny/Puck-v0", {"push": 2.0})
    trained = train_policies(task, replace(CONFIG, num_seeds=1, batch_steps=20), out=tmp_path / "run")
    seed = np.random.default_rng(EVALUATION_SEED).integers(2**31)
    returns, _ = play(trained.policy(), 1, int(seed))
    np.testing.assert_allclose(returns[0], trained.history["eval_return"][-1, 0], rtol=1e-5)
    assert "eval_success" not in trained.history  # the environment does not say what its goal is


def test_the_command_line_trains_plays_and_films(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, film = str(tmp_path / "run"), tmp_path / "film.gif"
    module = "tests.rl.tiny_gym_envs"
    arguments = [
        "train",
        f"gym:{module}:tiny/Puck-v0",
        "--seeds",
        "1",
        "--steps",
        "200",
        "--batch-steps",
        "100",
    ]
    assert main([*arguments, "--out", run]) == 0
    said = capsys.readouterr().err
    assert f"gym:{module}:tiny/Puck-v0: Gymnasium steps its environments one after another" in said
    assert main(["play", run]) == 2  # a file must not decide which module is imported
    assert "a task of your own: pass the task" in capsys.readouterr().err
    assert main(["play", run, "--task", arguments[1], "--episodes", "2", "--video", str(film)]) == 0
    assert capsys.readouterr().out.startswith(f"seed 0, 2 episodes of {arguments[1]}")
    from PIL import Image

    with Image.open(film) as picture:
        durations = [picture.seek(i) or picture.info["duration"] for i in range(picture.n_frames)]
        assert picture.size == (40, 32) and sum(durations) == 2000  # 40 steps of 0.05 s


@pytest.mark.filterwarnings("ignore:.*render_mode='rgb_array'")  # Gymnasium's own warning
def test_an_environment_that_cannot_be_drawn_is_not_filmed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = train_policies("gym:tiny/Blind-v0", CONFIG, out=tmp_path / "run").run
    assert main(["play", str(run), "--video", str(tmp_path / "film.gif")]) == 2
    assert "gym:tiny/Blind-v0 cannot be filmed: it has no render mode rgb_array." in capsys.readouterr().err


def test_the_joints_of_dm_control_are_read() -> None:
    """dm_control wraps MuJoCo's model and data, and keeps both in its `physics`."""
    import mujoco

    model, _ = TASKS["cartpole"].compile()
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3, 0.4
    env = gymnasium.make("tiny/Puck-v0")
    env.unwrapped.physics = SimpleNamespace(  # pyright: ignore
        model=SimpleNamespace(ptr=model), data=SimpleNamespace(ptr=data)
    )
    reader = state_reader(env)
    assert reader is not None and reader.names == TASKS["cartpole"].state_names
    assert reader().tolist() == [0.3, 0.4, 0, 0]


# --- real environments ------------------------------------------------------------------------------


@pytest.mark.nightly
def test_trpo_learns_to_balance_gymnasiums_pendulum() -> None:
    trained = train_policies(PENDULUM, TrainConfig(num_seeds=2, steps=60_000))
    first, last = trained.history["return"][0], trained.history["return"][-1]
    assert (last > 10 * first).all()  # from 5 and 7 to 97 and 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "env_id", "names"),
    [
        pytest.param(
            "shimmy",
            "dm_control/cartpole-swingup-v0",
            ("position_0", "hinge_1vel"),
            marks=pytest.mark.nightly,
        ),
        ("gymnasium_robotics", "AdroitHandDoorSparse-v1", ("obs_0", "ARTz")),
        pytest.param("gymnasium", "Hopper-v5", ("obs_10", "rootxvel"), marks=pytest.mark.nightly),
    ],
)
@pytest.mark.filterwarnings("default")  # the packages warn
def test_environments_of_other_packages(module: str, env_id: str, names: tuple, tmp_path: Path) -> None:
    pytest.importorskip(module, reason="needs the extra robots")
    task = GymTask(env_id)
    assert set(names) <= set(task.state_names)
    config = TrainConfig(num_seeds=2, steps=2 * task.horizon, batch_steps=task.horizon)
    history = train_policies(task, config, out=tmp_path / "run").history
    assert np.isfinite(history["return"]).all() and not history["frozen"].any()
    returns, _ = play(ps.load_policy(tmp_path / "run"), 1, 0)
    assert np.isfinite(returns).all()
    assert re.fullmatch(
        r"\d[\w.]+", json.loads((tmp_path / "run/config.json").read_text())["versions"]["gymnasium"]
    )
