"""One iteration of episodes for all seeds at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.envs.batch import TaskBatch
from planspace.rl.mlp import stacked
from planspace.rl.normalise import ObsStatistics
from planspace.rl.observe import Observer
from planspace.rl.policy import UNIT_ENTROPY, GaussianPolicy


class Actor:
    """The policies of all seeds as they act."""

    def __init__(
        self,
        policies: Sequence[GaussianPolicy],
        columns: slice,
        statistics: Sequence[ObsStatistics] | None = None,
    ):
        """Copies the weights.

        Args:
            policies: one a seed.
            columns: what they read of an observation.
            statistics: standardises observations, where that is wanted; one a seed.
        """
        self._mean, self._columns = stacked([p.mean for p in policies]), columns
        self._statistics = ObsStatistics.stacked(statistics) if statistics else None
        self.log_std = np.stack([np.asarray(p.log_std) for p in policies])
        """Logarithm of the deviation of the actions [seed, action]."""

    @property
    def entropy(self) -> Float[np.ndarray, " seed"]:
        """Of each policy's actions, the same everywhere [nat]."""
        return np.sum(self.log_std + UNIT_ENTROPY, axis=1)

    def mean(self, obs: Float[np.ndarray, "seed env obs"]) -> Float[np.ndarray, "seed env action"]:
        """The mean action of each policy in each of its environments."""
        if self._statistics is not None:
            obs = self._statistics(obs)
        return self._mean(obs[..., self._columns])


@dataclass(frozen=True)
class Rollout:
    """What happened in one iteration, of all seeds or, without that axis, of one."""

    obs: Float[np.ndarray, "time *seed env obs"]
    actions: Float[np.ndarray, "time *seed env action"]
    rewards: Float[np.ndarray, "time *seed env"]
    """The task's own."""
    shaping: Float[np.ndarray, "time *seed env"]
    """What coming nearer to the goal was rewarded by, beside them; see `shaping`."""
    step: Int[np.ndarray, "time *seed env"]
    """Steps since the episode's start, before the action."""
    terminated: Bool[np.ndarray, "time *seed env"]
    timeout: Bool[np.ndarray, "time *seed env"]
    """The episode reached the task's horizon there."""
    cut: Bool[np.ndarray, "time *seed env"]
    """The record ends there in the middle of an episode (the iteration's end, or diverged physics)."""
    next_obs: Float[np.ndarray, "time *seed env obs"]
    """What was observed after the action, before any restart."""

    def of_seed(self, i: int) -> "Rollout":
        """One seed's part, counted from 0."""
        return Rollout(**{f.name: np.ascontiguousarray(getattr(self, f.name)[:, i]) for f in fields(self)})


def collect(
    batch: TaskBatch,
    observer: Observer,
    actor: Actor,
    num_steps: int,
    rngs: list[np.random.Generator],
    *,
    shape: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None,
    noise: bool = True,
) -> Rollout:
    """Runs every environment for `num_steps`, from fresh episodes; when one ends, the next begins.

    Args:
        batch: seeds x environments, seed by seed.
        observer: what the policy and critic see.
        actor: one policy a seed.
        num_steps: steps of each environment.
        rngs: one stream a seed; a seed's starts and noise come from its own stream alone.
        shape: (states before and after, terminated, at the time limit) to what is paid beside the reward.
        noise: whether actions are drawn, or are the policies' means.
    """
    task, num_seeds = batch.task, len(rngs)
    num_envs = len(batch.states) // num_seeds
    size = (num_steps, num_seeds, num_envs)
    num_actions = actor.log_std.shape[-1]
    starts = [task.sample_starts(num_envs, rng) for rng in rngs]
    drawn = np.stack([rng.standard_normal((num_steps, num_envs, num_actions)) for rng in rngs], axis=1)
    drawn *= np.exp(actor.log_std)[:, None, :] if noise else 0.0
    batch.reset(*(np.concatenate(part) for part in zip(*starts, strict=True)))
    obs = observer(batch.states, batch.targets).reshape(num_seeds, num_envs, -1)
    record = Rollout(
        obs=np.empty((*size, obs.shape[-1]), np.float32),
        actions=np.empty((*size, num_actions), np.float32),
        rewards=np.empty(size),
        shaping=np.zeros(size),
        step=np.empty(size, int),
        terminated=np.empty(size, bool),
        timeout=np.empty(size, bool),
        cut=np.zeros(size, bool),
        next_obs=np.empty((*size, obs.shape[-1]), np.float32),
    )
    since_start = np.zeros(size[1:], int)
    for t in range(num_steps):
        actions = actor.mean(obs) + drawn[t]
        before = batch.states
        rewards, terminated, diverged = batch.step(actions.reshape(-1, num_actions))
        record.obs[t], record.actions[t], record.step[t] = obs, actions, since_start
        record.rewards[t], record.terminated[t] = rewards.reshape(size[1:]), terminated.reshape(size[1:])
        since_start = since_start + 1
        record.timeout[t] = ~record.terminated[t] & (since_start >= task.horizon)
        record.cut[t] = diverged.reshape(size[1:])
        if shape is not None:
            paid = shape(before, batch.states, terminated, record.timeout[t].ravel())
            record.shaping[t] = paid.reshape(size[1:])
        obs = observer(batch.states, batch.targets).reshape(num_seeds, num_envs, -1)
        record.next_obs[t] = obs
        ended = record.terminated[t] | record.timeout[t] | record.cut[t]
        if ended.any() and t + 1 < num_steps:
            _restart(batch, ended, rngs)
            since_start = np.where(ended, 0, since_start)
            obs = observer(batch.states, batch.targets).reshape(num_seeds, num_envs, -1)
    record.cut[-1] |= ~(record.terminated[-1] | record.timeout[-1])
    return record


def _restart(batch: TaskBatch, ended: Bool[np.ndarray, "seed env"], rngs: list[np.random.Generator]) -> None:
    starts = [batch.task.sample_starts(int(n), rng) for n, rng in zip(ended.sum(axis=1), rngs, strict=True)]
    states, targets = (np.concatenate(part) for part in zip(*starts, strict=True))
    batch.reset(states, targets, np.flatnonzero(ended).astype(np.int32))


def episode_returns(rollout: Rollout) -> tuple[Float[np.ndarray, " seed"], Float[np.ndarray, " seed"]]:
    """Mean return and length of each seed's episodes that ended (of all, if none did), undiscounted."""
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


def first_returns(rollout: Rollout) -> Float[np.ndarray, " seed"]:
    """Mean return of the first episode of each environment, by seed, undiscounted."""
    ended = rollout.terminated | rollout.timeout | rollout.cut
    over = np.cumsum(ended, axis=0) - ended > 0  # an episode ended before this step
    return np.where(over, 0.0, rollout.rewards).sum(axis=0).mean(axis=1)
