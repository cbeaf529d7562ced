"""One iteration of episodes for all seeds at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.envs.episodes import Episodes
from planspace.errors import UsageError
from planspace.rl.algorithm import HOW_TO
from planspace.rl.observe import Observer

ActFn = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(observations [seed, env, obs], unit Gaussian noise [seed, env, action]) to actions [seed, env, action]."""
ShapeFn = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(states before and after a step, terminated, at the time limit) to the shaping reward."""


@dataclass(frozen=True)
class Rollout:
    """The steps of one iteration, of all seeds or, without the axis of seeds, of one seed."""

    obs: Float[np.ndarray, "time *seed env obs"]
    actions: Float[np.ndarray, "time *seed env action"]
    rewards: Float[np.ndarray, "time *seed env"]
    """Rewards of the task."""
    shaping: Float[np.ndarray, "time *seed env"]
    """Shaping rewards, which are paid in addition; see `shaping`. With the reward `progress`, its difference
    from the reward of the task."""
    step: Int[np.ndarray, "time *seed env"]
    """Steps from the start of the episode to the action."""
    terminated: Bool[np.ndarray, "time *seed env"]
    timeout: Bool[np.ndarray, "time *seed env"]
    """Whether the episode reached its time limit there."""
    cut: Bool[np.ndarray, "time *seed env"]
    """Whether the record ends there within an episode: at the end of the iteration, or where physics
    diverged."""
    next_obs: Float[np.ndarray, "time *seed env obs"]
    """Observations after the action, before the next episode starts."""

    def of_seed(self, i: int) -> "Rollout":
        """The part of seed number `i`, counted from 0."""
        return Rollout(**{f.name: np.ascontiguousarray(getattr(self, f.name)[:, i]) for f in fields(self)})


def collect(
    episodes: Episodes,
    observer: Observer,
    act: ActFn,
    num_steps: int,
    rngs: Sequence[np.random.Generator],
    *,
    shape: ShapeFn | None = None,
) -> Rollout:
    """Run every environment for `num_steps` from fresh episodes; when an episode ends, the next begins.

    Args:
        episodes: the environments of all seeds, seed by seed.
        observer: what the policy and critic see.
        act: the actions of all seeds.
        num_steps: steps of each environment.
        rngs: one stream per seed; the starts and noise of a seed come from its own stream only.
        shape: the shaping reward, if there is any.
    """
    num_seeds, num_actions = len(rngs), len(episodes.action_limits[0])
    num_envs = len(episodes.states) // num_seeds
    size = (num_steps, num_seeds, num_envs)
    episodes.reset(rngs)
    noise = np.stack([rng.standard_normal((num_steps, num_envs, num_actions)) for rng in rngs], axis=1)
    obs = observer(episodes.states, episodes.targets).reshape(num_seeds, num_envs, -1)
    record = _empty_rollout(size, obs.shape[-1], num_actions)
    since_start = np.zeros(size[1:], int)
    for t in range(num_steps):
        actions = act(obs, noise[t])
        if np.shape(actions) != noise[t].shape:
            raise wrong_actions(np.shape(actions), noise[t].shape)
        before = episodes.states
        steps = episodes.step(actions.reshape(-1, num_actions))
        record.obs[t], record.actions[t], record.step[t] = obs, actions, since_start
        for name, numbers in steps._asdict().items():
            getattr(record, name)[t] = numbers.reshape(size[1:])
        since_start = since_start + 1
        if shape is not None:
            paid = shape(before, episodes.states, steps.terminated, steps.timeout)
            record.shaping[t] = paid.reshape(size[1:])
        obs = observer(episodes.states, episodes.targets).reshape(num_seeds, num_envs, -1)
        record.next_obs[t] = obs
        ended = record.terminated[t] | record.timeout[t] | record.cut[t]
        if ended.any() and t + 1 < num_steps:
            episodes.reset(rngs, ended)
            since_start = np.where(ended, 0, since_start)
            obs = observer(episodes.states, episodes.targets).reshape(num_seeds, num_envs, -1)
    record.cut[-1] |= ~(record.terminated[-1] | record.timeout[-1])
    return record


def _empty_rollout(size: tuple[int, int, int], num_obs: int, num_actions: int) -> Rollout:
    """Arrays for steps of this size [time, seed, env], to be filled."""
    return Rollout(
        obs=np.empty((*size, num_obs), np.float32),
        actions=np.empty((*size, num_actions), np.float32),
        rewards=np.empty(size),
        shaping=np.zeros(size),
        step=np.empty(size, int),
        terminated=np.empty(size, bool),
        timeout=np.empty(size, bool),
        cut=np.empty(size, bool),
        next_obs=np.empty((*size, num_obs), np.float32),
    )


def wrong_actions(got: tuple[int, ...], wanted: tuple[int, ...]) -> UsageError:
    """Build the error for actions of another shape."""
    return UsageError(
        f"Algorithm.collect must act with shape [seed, env, action] = {wanted}, got {got}. See {HOW_TO}."
    )


def episode_returns(rollout: Rollout) -> tuple[Float[np.ndarray, " seed"], Float[np.ndarray, " seed"]]:
    """Mean undiscounted return and length of each seed's episodes that ended, or of all if none ended."""
    ended = rollout.terminated | rollout.timeout
    returns = np.empty(ended.shape[1])
    lengths = np.empty(ended.shape[1])
    for s in range(ended.shape[1]):
        totals, counts = [], []
        for e in range(ended.shape[2]):
            stops = np.flatnonzero(ended[:, s, e] | rollout.cut[:, s, e]) + 1
            for a, b in zip([0, *stops[:-1]], stops, strict=True):
                totals.append(rollout.rewards[a:b, s, e].sum())
                counts.append((b - a, ended[b - 1, s, e]))
        whole = np.array([done for _, done in counts])
        keep = whole if whole.any() else np.ones(len(whole), bool)
        returns[s] = np.mean(np.array(totals)[keep])
        lengths[s] = np.mean(np.array([n for n, _ in counts])[keep])
    return returns, lengths


def first_episodes(rollout: Rollout) -> Bool[np.ndarray, "time *seed env"]:
    """Whether each step belongs to the first episode of its environment."""
    ended = rollout.terminated | rollout.timeout | rollout.cut
    return np.cumsum(ended, axis=0) - ended == 0
