"""Policies at play: deterministic episodes in the environment they were trained in, and a film of them."""

import gymnasium
import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.envs.wrappers import PlanSpaceObservation
from planspace.rl.saved_policy import Policy
from planspace.tasks.catalog import find_task


def make_env(policy: Policy) -> gymnasium.Env:
    """The environment a policy was trained in, z included."""
    about = policy.about
    env_id = find_task(about["task"]).env_id  # not what a file says: Gymnasium imports what an id names
    env = gymnasium.make(env_id, obs=about["obs"], reward=about.get("reward", "dense"))
    if about["z"] == "none":
        return env
    mode = "replace" if about["z"] == "replace" and about["z_to"] == "both" else "augment"
    return PlanSpaceObservation(env, policy.embedding, mode)


@np.errstate(over="ignore", invalid="ignore")  # the policy sees whether its actions are finite
def play(policy: Policy, num: int, seed: int) -> tuple[Float[np.ndarray, " episode"], Demos]:
    """Plays episodes, each action the policy's mean.

    Args:
        policy: the policy.
        num: how many episodes.
        seed: of their starts.

    Returns:
        The return of each, and the episodes themselves.

    Raises:
        PlanspaceError: an action is not finite.
    """
    env, task = make_env(policy), find_task(policy.about["task"])
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
    mjcf = task.mjcf
    info = StateInfo.of_model(model, space, problem=task.problem, joints=task.joints, mjcf=mjcf)
    return returns, Demos.from_episodes(info, episodes)
