"""Plays trained policies: episodes without exploration in the environment they were trained in."""

import gymnasium
import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.envs import make as envs
from planspace.errors import UsageError
from planspace.rl.saved_policy import Policy
from planspace.tasks.catalog import find_task
from planspace.tasks.stored_task import stored_task
from planspace.tasks.task import Task


def make_env(policy: Policy, task: Task | None = None) -> gymnasium.Env:
    """The environment a policy was trained in, z included.

    Args:
        policy: the policy.
        task: its task, if planspace does not ship it and the run does not hold it.

    Raises:
        UsageError: the policy belongs to another task, or its task is not shipped and was not given.
    """
    about = policy.about
    task = _task_of(policy, task)
    return envs.make_env(
        task,
        obs=about["obs"],
        reward=about.get("reward", "dense"),
        embedding=None if about["z"] == "none" else policy.embedding,
        mode="replace" if about["z"] == "replace" and about["z_to"] == "both" else "augment",
    )


def _task_of(policy: Policy, task: Task | None) -> Task:
    name, known = policy.about["task"], policy.about.get("task_sha256")
    if task is None and known is None:
        return find_task(name)
    task = stored_task(policy.run) if task is None else task
    if task is None:
        raise UsageError(
            f"{policy.run} was trained on {name!r}, a task of your own: pass the task (`--task "
            "module.py:NAME`)."
        )
    if task.name != name:
        raise UsageError(f"{policy.run} was trained on the task {name!r}, got {task.name!r}.")
    if known not in (None, task.hash):
        raise UsageError(f"{policy.run} was trained on another version of the task {name!r}.")
    return task


@np.errstate(over="ignore", invalid="ignore")  # the policy checks that its actions are finite
def play(
    policy: Policy, num: int, seed: int, task: Task | None = None
) -> tuple[Float[np.ndarray, " episode"], Demos]:
    """Play episodes without exploration.

    Args:
        policy: the policy.
        num: number of episodes.
        seed: seed of the first episode's start; the others follow it.
        task: its task, if planspace does not ship it and the run does not hold it.

    Returns:
        The return of each episode, and the episodes.

    Raises:
        PlanspaceError: an action is not finite.
        UsageError: as `make_env`.
    """
    task = _task_of(policy, task)
    env = make_env(policy, task)
    model, space = task.compile()
    step = task.frame_skip * model.opt.timestep
    returns, episodes = np.zeros(num), []
    for i in range(num):
        obs, info = env.reset(seed=seed + i)
        states, actions, ended = [info["state"]], [], False
        while not ended:
            action = policy(obs)
            obs, reward, terminated, truncated, info = env.step(action)
            returns[i] += float(reward)
            states.append(info["state"])
            actions.append(action)
            ended = terminated or truncated
        times = step * np.arange(len(states))
        goal = np.full(space.size, np.nan)
        episodes.append(
            Episode(np.stack(states), np.stack(actions).astype(float), times, goal, False, i, seed + i)
        )
    info = StateInfo.of_model(model, space, problem=task.problem_name, joints=task.joints, source=task.source)
    return returns, Demos.from_episodes(info, episodes)
