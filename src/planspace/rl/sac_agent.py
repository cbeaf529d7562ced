"""Soft actor-critic of one seed: its state, its exploration, and its update from an iteration of episodes."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, Key
from scipy.special import ndtr

from planspace.errors import UsageError
from planspace.rl.algorithm import Diverged
from planspace.rl.algorithms.sac import SAC
from planspace.rl.arm import Arm
from planspace.rl.cloning import Examples, imitate
from planspace.rl.normalise import BOUND, ObsStatistics
from planspace.rl.policy_network import PolicyNetwork
from planspace.rl.rollout import Rollout
from planspace.rl.sac_update import (
    LOG_STD_LIMITS,
    Batch,
    Learner,
    Noise,
    UpdateInfo,
    gradient_step,
    mean_action,
    new_learner,
)
from planspace.rl.stack import scaled, stacked
from planspace.rl.transitions import Transitions

Columns = tuple[int | None, int | None]


class SACState(eqx.Module):
    """The state of one seed."""

    learner: Learner
    replay: Transitions
    """The last `replay_size` steps, shaping rewards included; 0 where there is no step yet."""
    num_steps: Int[np.ndarray, ""]
    """Environment steps so far."""
    statistics: ObsStatistics
    """Mean and standard deviation of observations; empty unless `normalise_obs` is set."""


class _Source(NamedTuple):
    """Where batches come from."""

    replay: Transitions
    filled: Int[Array | np.ndarray, ""]
    """Rows of the replay that hold steps."""
    plans: Transitions | None


class _Reader(eqx.Module):
    """How the networks read transitions."""

    columns: tuple[Columns, Columns] = eqx.field(static=True)
    """The columns that the policy and the critics read."""
    limits: tuple[Float[np.ndarray, " action"], Float[np.ndarray, " action"]]
    """Lower and upper limits of an action."""
    scale: tuple[Float[np.ndarray, " obs"], Float[np.ndarray, " obs"]] | None
    """Mean and standard deviation by which observations are standardised, if they are."""

    def __call__(self, rows: Sequence[Array]) -> Batch:
        """What the networks see of rows of `Transitions`."""
        (low, high), (obs, actions, rewards, next_obs, terminated) = self.limits, rows
        if self.scale is not None:
            mean, std = self.scale
            obs, next_obs = (jnp.clip((x - mean) / std, -BOUND, BOUND) for x in (obs, next_obs))
        policy, critic = (slice(*part) for part in self.columns)
        return Batch(
            policy_obs=obs[:, policy],
            critic_obs=obs[:, critic],
            actions=(actions - (low + high) / 2) / ((high - low) / 2),
            rewards=rewards,
            next_policy_obs=next_obs[:, policy],
            next_critic_obs=next_obs[:, critic],
            terminated=terminated,
        )


def new_state(settings: SAC, arm: Arm, *, key: Key[Array, ""]) -> SACState:
    """The state of a seed before training.

    Raises:
        UsageError: an action has no limits.
    """
    limits = np.concatenate(arm.episodes.action_limits)
    if not np.isfinite(limits).all():
        raise UsageError(
            f"SAC needs limits of all actions, and {arm.task.name} with the reward {arm.config.reward!r} has "
            "an action without. Train it with trpo or ppo."
        )
    num_obs, num_actions = arm.observer.num_obs, arm.num_actions
    rows = min(settings.replay_size, arm.config.iterations * arm.steps)
    replay = Transitions(
        obs=np.zeros((rows, num_obs), np.float32),
        actions=np.zeros((rows, num_actions), np.float32),
        rewards=np.zeros(rows, np.float32),
        next_obs=np.zeros((rows, num_obs), np.float32),
        terminated=np.zeros(rows, bool),
    )
    learner = new_learner(settings, arm.num_policy_obs, arm.observer.num_critic_obs, num_actions, key=key)
    return SACState(learner, replay, np.array(0), ObsStatistics.empty(num_obs))


def clone(settings: SAC, arm: Arm, state: SACState, *, key: Key[Array, ""]) -> SACState:
    """The state after gradient steps that bring the mean action to the controls of plans.

    From then on, observations are standardised as those of the plans.
    """
    steps, statistics = arm.plan_transitions, state.statistics
    assert steps is not None
    if settings.normalise_obs:
        statistics = ObsStatistics.of(steps.obs)
    reader = _reader(arm, statistics if settings.normalise_obs else None)
    examples = _examples(reader, list(map(jnp.asarray, steps)), np.zeros((), np.float32))
    actor = imitate(state.learner.actor, mean_action, examples, arm.config.clone, key=key)
    learner = eqx.tree_at(lambda learner: learner.actor, state.learner, actor)
    return SACState(learner, state.replay, state.num_steps, statistics)


def collect(
    settings: SAC, arm: Arm, states: Sequence[SACState], rngs: Sequence[np.random.Generator]
) -> Rollout:
    """Episodes of all seeds, with actions drawn from their policies."""
    explorer = _Explorer(settings, arm, states)
    return arm.rollout(explorer, rngs, discount=settings.discount, bootstrap_timeout=True)


class _Explorer:
    """The policies of all seeds as they explore; one call acts in every environment."""

    def __init__(self, settings: SAC, arm: Arm, states: Sequence[SACState]):
        self._outputs = stacked([state.learner.actor for state in states])
        self._columns, self._limits = arm.observer.policy_columns, arm.episodes.action_limits
        parts = [state.statistics for state in states]
        self._statistics = ObsStatistics.stacked(parts) if settings.normalise_obs else None
        self._num_steps = np.array([state.num_steps for state in states])
        self._learning_starts = settings.learning_starts

    def __call__(
        self, obs: Float[np.ndarray, "seed env obs"], noise: Float[np.ndarray, "seed env action"]
    ) -> Float[np.ndarray, "seed env action"]:
        """Uniformly random actions at first, then actions drawn from the policies."""
        if self._statistics is not None:
            obs = self._statistics(obs)
        mean, log_std = np.split(self._outputs(obs[..., self._columns]), 2, axis=-1)
        drawn = np.tanh(mean + np.exp(np.clip(log_std, *LOG_STD_LIMITS)) * noise)
        uniform = 2.0 * ndtr(noise) - 1.0  # the distribution function of the noise
        first = self._num_steps < self._learning_starts
        self._num_steps = self._num_steps + obs.shape[1]
        return scaled(np.where(first[:, None, None], uniform, drawn), *self._limits)


def act(settings: SAC, arm: Arm, state: SACState) -> PolicyNetwork:
    """The network of the mean, squashed between the limits of an action."""
    actor, num = state.learner.actor, arm.num_actions
    weights, biases = (list(map(np.asarray, part)) for part in (actor.weights, actor.biases))
    low, high = arm.episodes.action_limits
    return PolicyNetwork(
        [*weights[:-1], weights[-1][:num]],
        [*biases[:-1], biases[-1][:num]],
        statistics=state.statistics if settings.normalise_obs else None,
        activation="relu",
        limits=(low, high),
    )


def update(
    settings: SAC, arm: Arm, state: SACState, rollout: Rollout, *, key: Key[Array, ""]
) -> tuple[SACState, dict[str, float]]:
    """The state after an iteration, and numbers of the update for the history.

    The numbers are means over the gradient steps; NaN if there were none, because `learning_starts` has not
    been reached.

    Args:
        settings: hyper-parameters.
        arm: what is trained on.
        state: the state of the seed.
        rollout: the episodes of the seed.
        key: random key of batches and actions.

    Raises:
        Diverged: an observation, an action or a reward is not finite.
    """
    new = _transitions(rollout)
    if not all(np.isfinite(part).all() for part in new):
        raise Diverged
    replay = _with_more(state.replay, new, int(state.num_steps))
    num_steps = np.asarray(state.num_steps + len(new.rewards))
    statistics = state.statistics
    if settings.normalise_obs and not arm.config.clone:
        statistics = statistics.with_more(new.obs)
    learner, numbers = state.learner, dict.fromkeys(UpdateInfo._fields, np.nan)
    if num_steps > settings.learning_starts:
        keys = jr.split(key, max(1, round(settings.updates_per_step * len(new.rewards))))
        plans = arm.plan_transitions if arm.config.replay or arm.clone_weight > 0 else None
        source = _Source(replay, np.asarray(min(int(num_steps), len(replay.rewards))), plans)
        num_plans = round(arm.config.replay * settings.batch) if plans else 0
        reader = _reader(arm, statistics if settings.normalise_obs else None)
        weight = np.asarray(arm.clone_weight, np.float32) if arm.clone_weight > 0 else None
        learner, info = _learn(settings, num_plans, learner, source, reader, keys, weight)
        numbers = {name: float(number) for name, number in info._asdict().items()}
    return SACState(learner, replay, num_steps, statistics), numbers


def _transitions(rollout: Rollout) -> Transitions:
    """The steps of an iteration, in the order of time; the shaping reward is paid."""
    with np.errstate(over="ignore", invalid="ignore"):
        paid = (rollout.rewards + rollout.shaping).astype(np.float32)
    parts = rollout.obs, rollout.actions, paid, rollout.next_obs, rollout.terminated
    return Transitions(*(part.reshape(-1, *part.shape[2:]) for part in parts))


def _with_more(replay: Transitions, new: Transitions, num_steps: int) -> Transitions:
    """The replay with more rows, which replace the oldest if it is full.

    Args:
        replay: the replay.
        new: the rows.
        num_steps: the number of rows that were added before.
    """
    size = len(replay.rewards)
    slots = (num_steps + np.arange(len(new.rewards))[-size:]) % size
    more = Transitions(*map(np.copy, replay))
    for part, rows in zip(more, new, strict=True):
        part[slots] = rows[-size:]
    return more


def _reader(arm: Arm, statistics: ObsStatistics | None) -> _Reader:
    observer, scale = arm.observer, None
    if statistics is not None:
        scale = statistics.mean.astype(np.float32), statistics.std.astype(np.float32)
    policy, critic = ((c.start, c.stop) for c in (observer.policy_columns, observer.critic_columns))
    low, high = (np.asarray(limit, np.float32) for limit in arm.episodes.action_limits)
    return _Reader((policy, critic), (low, high), scale)


@eqx.filter_jit
def _learn(
    settings: SAC,
    num_plans: int,
    learner: Learner,
    source: _Source,
    reader: _Reader,
    keys: Key[Array, " update"],
    clone_weight: Float[np.ndarray | Array, ""] | None,
) -> tuple[Learner, UpdateInfo]:
    """Take one gradient step for each key, and return the mean of their numbers.

    Args:
        settings: hyper-parameters.
        num_plans: rows of each batch that come from plans.
        learner: the networks.
        source: where rows come from.
        reader: how the networks read them.
        keys: a random key for each gradient step.
        clone_weight: weight of the penalty for actions that differ from those of plans; None without.
    """

    def step(learner: Learner, key: Key[Array, ""]) -> tuple[Learner, UpdateInfo]:
        row_key, plan_key, now_key, then_key = jr.split(key, 4)
        rows = _drawn(source.replay, source.filled, settings.batch - num_plans, key=row_key)
        if source.plans is not None:
            planned = _drawn(source.plans, len(source.plans.rewards), num_plans, key=plan_key)
            rows = [jnp.concatenate(parts) for parts in zip(rows, planned, strict=True)]
        size = settings.batch, len(reader.limits[0])
        noise = Noise(jr.normal(now_key, size), jr.normal(then_key, size))
        examples = None
        if clone_weight is not None:
            assert source.plans is not None
            planned = _drawn(
                source.plans, len(source.plans.rewards), settings.batch, key=jr.fold_in(plan_key, 0)
            )
            examples = _examples(reader, planned, clone_weight)
        return gradient_step(settings, learner, reader(rows), noise, examples)

    learner, infos = jax.lax.scan(step, learner, keys)
    return learner, jax.tree.map(jnp.mean, infos)


def _examples(reader: _Reader, rows: Sequence[Array], weight: Float[np.ndarray | Array, ""]) -> Examples:
    """Rows of transitions along plans, as the policy is to imitate them."""
    batch = reader(rows)
    return Examples(batch.policy_obs, batch.actions, np.ones(batch.actions.shape[1], np.float32), weight)


def _drawn(
    source: Transitions, filled: int | Int[Array | np.ndarray, ""], num: int, *, key: Key[Array, ""]
) -> list[Array]:
    """Rows drawn uniformly from the first ones."""
    rows = jr.randint(key, (num,), 0, filled)
    return [jnp.asarray(part)[rows] for part in source]
