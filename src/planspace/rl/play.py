"""Plays trained policies: episodes without exploration in the environment they were trained in."""

import contextlib
import itertools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float, UInt8

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.render import FilmConfig, render_demos, write_film
from planspace.demos.state_info import StateInfo
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.envs import make as envs
from planspace.errors import UsageError
from planspace.physics.rendering import rendering_backend
from planspace.progress import progress
from planspace.rl.goal_observation import GoalObservation
from planspace.rl.observe import Observer
from planspace.rl.pixels import PixelObservations
from planspace.rl.saved_policy import Policy
from planspace.tasks.action_repeat import repeat_actions, single_actions
from planspace.tasks.catalog import GYM_PREFIX, find_task
from planspace.tasks.dm_control.suite import DMC_PREFIX
from planspace.tasks.gymnasium import AnyTask, GymTask, parse_gym_task
from planspace.tasks.stored_task import stored_task, task_content
from planspace.tasks.task_hash import with_todays_hash


def make_env(
    policy: Policy, task: AnyTask | None = None, render_mode: str | None = None
) -> gymnasium.Env[Any, Any]:
    """The environment a policy was trained in, z included.

    Args:
        policy: the policy.
        task: its task, if planspace does not ship it and the run does not hold it.
        render_mode: a render mode of the environment, or None.

    Raises:
        UsageError: the policy belongs to another task, or its task is not shipped and was not given.
    """
    about = policy.about
    task = _task_of(policy, task)
    reward = about.get("reward", "dense")
    if about.get("goal", "raw") == "z":
        own = envs.make_env(task, obs=about["obs"], reward=reward, render_mode=render_mode)
        embedding = policy.load_embedding()
        observer = Observer(task, about["obs"], about["z"], about["z_to"], (embedding,), goal="z")
        return GoalObservation(own, observer)
    return envs.make_env(
        task,
        obs=about["obs"],
        reward=reward,
        render_mode=render_mode,
        embedding=None if about["z"] == "none" else policy.load_embedding(),
        mode="replace" if about["z"] == "replace" and about["z_to"] == "both" else "augment",
    )


def _task_of(policy: Policy, task: AnyTask | None) -> AnyTask:
    about, name = policy.about, policy.about["task"]
    known = {key: value for key, value in about.items() if key in ("task_sha256", "environment")}
    if task is None and (not known or name.startswith(DMC_PREFIX)):
        task = find_task(name)
    if task is None:
        task = parse_gym_task(known["environment"]) if "environment" in known else stored_task(policy.run)
    if task is None:
        raise UsageError(
            f"{policy.run} was trained on {name!r}, a task of your own: pass the task (`--task "
            f"{name if name.startswith(GYM_PREFIX) else 'module.py:NAME'}`)."
        )
    if task.name != name:
        raise UsageError(f"{policy.run} was trained on the task {name!r}, got {task.name!r}.")
    if known and with_todays_hash(known, single_actions(task)) != task_content(task):
        raise UsageError(f"{policy.run} was trained on another version of the task {name!r}.")
    return repeat_actions(task, about.get("action_repeat", 1))


@np.errstate(over="ignore", invalid="ignore")  # the policy checks that its actions are finite
def play(
    policy: Policy,
    num: int,
    seed: int,
    task: AnyTask | None = None,
    starts: Float[np.ndarray, "episode state"] | None = None,
    encoder: ImageEncoder | None = None,
) -> tuple[Float[np.ndarray, " episode"], Demos]:
    """Play episodes without exploration.

    Args:
        policy: the policy.
        num: number of episodes.
        seed: seed of the first episode's start; the others follow it.
        task: its task, if planspace does not ship it and the run does not hold it.
        starts: the state in which each episode starts; by default the seeds draw them.
        encoder: reads z and the state from pictures, and the policy sees these; None shows it the true ones.

    Returns:
        The return of each episode, and the episodes.

    Raises:
        PlanspaceError: an action is not finite, or a Gymnasium environment does not start where it is told.
        UsageError: as `make_env`, or policy and encoder do not fit together.
    """
    task = _task_of(policy, task)
    seen = None if encoder is None else PixelObservations(policy, task, encoder)
    env = make_env(policy, task)
    described, step = _described_states(task, env)
    returns, episodes = np.zeros(num), []
    for i in range(num):
        obs, info = env.reset(seed=seed + i, options=None if starts is None else {"state": starts[i]})
        states, actions, ended = [info["state"]], [], False
        if seen is not None:
            seen.restart(seed + i)
        while not ended:
            action = policy(obs if seen is None else seen(states[-1], env.unwrapped))
            if seen is not None:
                seen.applied(action)
            obs, reward, terminated, truncated, info = env.step(action)
            returns[i] += float(reward)
            states.append(info["state"])
            actions.append(action)
            ended = terminated or truncated
        times = step * np.arange(len(states))
        goal = np.full(len(described.names), np.nan)
        episodes.append(
            Episode(np.stack(states), np.stack(actions).astype(float), times, goal, False, i, seed + i)
        )
    env.close()
    return returns, Demos.from_episodes(described, episodes)


def film(policy: Policy, demos: Demos, file: Path, task: AnyTask | None = None) -> None:
    """Film the first episodes that `play` returned.

    Args:
        policy: the policy.
        demos: the episodes.
        file: the GIF or MP4 file to write.
        task: as for `play`.

    Raises:
        UsageError: the environment cannot draw itself, or the file is neither GIF nor MP4.
        PlanspaceError: no OpenGL backend works, or the file cannot be written.
    """
    config = FilmConfig()
    if demos.info.source is not None:
        render_demos(demos, file, config)
        return
    if backend := rendering_backend():
        os.environ.setdefault("MUJOCO_GL", backend)  # what Gymnasium tries first may fail
    env = make_env(policy, task, "rgb_array")  # it draws itself, so the episodes are played again
    if "rgb_array" not in env.metadata.get("render_modes", ()):
        raise UsageError(f"{policy.about['task']} cannot be filmed: it has no render mode rgb_array.")
    step = float(demos.times[1])
    every = max(1, round(1.0 / (config.fps * step)))
    episodes = [demos.episode(i) for i in range(min(config.episodes, len(demos)))]
    num = sum(-(-len(episode.controls) // every) for episode in episodes)
    with contextlib.closing(env), progress("render", num, unit="frame") as bar:
        pictures = _pictures(env, episodes, every, bar)
        first = next(pictures)
        height, width = first.shape[0] // 2 * 2, first.shape[1] // 2 * 2  # an MP4 needs even numbers
        config = FilmConfig(fps=min(100, max(1, round(1.0 / (every * step)))), width=width, height=height)
        write_film(file, (p[:height, :width] for p in itertools.chain([first], pictures)), config)


def _pictures(
    env: gymnasium.Env[Any, Any], episodes: Sequence[Episode], every: int, bar: Any
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """Pictures of an environment that repeats episodes, before every few steps."""
    for episode in episodes:
        env.reset(seed=episode.seed)
        for t, action in enumerate(episode.controls):
            if t % every == 0:
                yield np.asarray(env.render(), np.uint8)
                bar.update()
            env.step(action)


def _described_states(task: AnyTask, env: gymnasium.Env[Any, Any]) -> tuple[StateInfo, float]:
    """The meaning of the states of an episode, and the duration of a step [s]."""
    if isinstance(task, GymTask):
        names = task.state_names
        return StateInfo(names, ("",) * len(names), (), len(task.sizes.action_low)), env.unwrapped.step_time
    model, space = task.compile()
    known = {"problem": task.problem_name, "joints": task.joints, "source": task.source}
    step = task.action_repeat * task.frame_skip * model.opt.timestep
    return StateInfo.of_model(model, space, **known), step
