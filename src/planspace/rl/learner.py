"""One seed: its policy and critic, and how they learn from an iteration of episodes.

Everything here is written for one seed. `train` runs the seeds' updates side by side in threads: measured on
two cores that takes 0.5 to 0.7 of the time of one program with an axis of seeds, and it makes what a seed
learns independent, bit for bit, of how many learn beside it.
"""

import functools
import itertools
from typing import Any

import equinox as eqx
import jax
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Key

from planspace.rl import ppo, trpo
from planspace.rl.config import LearnerConfig, PPOConfig, TrainConfig
from planspace.rl.critic import Critic, make_critic
from planspace.rl.normalise import ObsStatistics
from planspace.rl.observe import Observer
from planspace.rl.policy import UNIT_ENTROPY, GaussianPolicy, UpdateInfo
from planspace.rl.rollout import Rollout


class Learner(eqx.Module):
    """Everything of a seed that changes from one iteration to the next."""

    policy: GaussianPolicy
    adam: optax.OptState | None
    """Of PPO's policy; nothing for TRPO."""
    critic: Critic
    statistics: ObsStatistics
    """Of nothing, unless observations are to be standardised."""
    frozen: np.ndarray
    """Whether it came upon a number that is not finite; it learns no more and acts as it last did."""


def make_learner(
    config: TrainConfig, observer: Observer, num_actions: int, *, key: Key[Array, ""]
) -> Learner:
    """A learner that has seen nothing yet."""
    learner, num_policy, num_critic = config.learns, observer.num_policy_obs, observer.num_critic_obs
    hidden = matched(learner.hidden, num_policy, num_policy + learner.match_z, num_actions)
    critic_hidden = matched(learner.critic_hidden, num_critic, num_critic + learner.match_z, 1)
    policy = GaussianPolicy(num_policy, num_actions, hidden=hidden, layer_norm=learner.layer_norm, key=key)
    return Learner(
        policy=policy,
        adam=ppo.optimiser(learner.ppo).init(eqx.filter(policy, eqx.is_array))
        if config.algo == "ppo"
        else None,
        critic=make_critic(learner.critic, num_critic, critic_hidden, key=jr.fold_in(key, 0)),
        statistics=ObsStatistics.empty(observer.num_obs),
        frozen=np.array(False),
    )


def matched(hidden: tuple[int, ...], num_obs: int, num_more: int, num_outputs: int) -> tuple[int, ...]:
    """Hidden layers so wide that a network on `num_obs` inputs has as many parameters as `hidden` on more.

    Args:
        hidden: units of the layers to be matched.
        num_obs: inputs of the network that is made wider.
        num_more: inputs of the network with `hidden`.
        num_outputs: outputs of both.

    Returns:
        `hidden`, each layer wider by the same number of units: the least that has at least as many.
    """

    def count(sizes: tuple[int, ...]) -> int:
        return sum((a + 1) * b for a, b in itertools.pairwise(sizes))

    wanted, extra = count((num_more, *hidden, num_outputs)), 0
    while count((num_obs, *(n + extra for n in hidden), num_outputs)) < wanted:
        extra += 1
    return tuple(n + extra for n in hidden)


def values(
    learner: Learner, rollout: Rollout, observer: Observer, config: TrainConfig
) -> tuple[Float[np.ndarray, "time env"], Float[np.ndarray, "time env"]]:
    """The critic's value before and after each step; after a step that ends an episode for good, 0.

    The next state is mostly the next row's. Where the record was cut it is not, nor at the time limit, beyond
    which the 2020 runs took nothing to lie.

    Args:
        learner: the seed's.
        rollout: the seed's.
        observer: which columns the critic reads.
        config: whether what lies beyond the time limit counts.
    """
    learns = config.learns

    def ask(obs: np.ndarray, step: np.ndarray) -> np.ndarray:
        return learner.critic.values(_seen(learner, obs, learns)[..., observer.critic_columns], step)

    value = ask(rollout.obs, rollout.step)
    next_value = np.zeros_like(value)
    next_value[:-1] = value[1:]
    next_value[rollout.timeout | rollout.terminated] = 0.0
    asked = rollout.cut | (rollout.timeout & learns.bootstrap_timeout)
    next_value[asked] = ask(rollout.next_obs[asked], rollout.step[asked] + 1)
    return value, next_value


def learn(
    learner: Learner,
    rollout: Rollout,
    advantages: Float[np.ndarray, "time env"],
    returns: Float[np.ndarray, "time env"],
    observer: Observer,
    config: TrainConfig,
    *,
    key: Key[Array, ""],
) -> tuple[Learner, dict[str, float]]:
    """Policy and critic after an iteration, and numbers of the update for the history.

    Where a number is not finite, the learner stays as it was, frozen.

    Args:
        learner: the seed's.
        rollout: the seed's.
        advantages: of the actions taken.
        returns: what the critic is fitted to.
        observer: which columns policy and critic read.
        config: the algorithm, and how to learn.
        key: of the minibatches.
    """
    learns = config.learns
    policy_key, critic_key = jr.split(key)
    entropy = float(np.sum(np.asarray(learner.policy.log_std) + UNIT_ENTROPY))
    still = {"kl": 0.0, "entropy": entropy, "loss": 0.0, "improvement": 0.0, "skipped": 1.0}
    if learner.frozen or not (np.isfinite(advantages).all() and np.isfinite(returns).all()):
        return eqx.tree_at(lambda x: x.frozen, learner, np.array(True)), still
    if learns.normalise_advantages:
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    obs = _seen(learner, rollout.obs, learns)
    policy, adam, info = _updated(
        learner,
        obs[..., observer.policy_columns],
        rollout.actions,
        advantages.astype(np.float32),
        config,
        key=policy_key,
    )
    numbers = {name: float(getattr(info, name)) for name in still}
    critic = learner.critic.fitted(
        _rows(obs[..., observer.critic_columns]), rollout.step.ravel(), returns.ravel(), key=critic_key
    )
    diverged = (config.algo == "ppo" and numbers["skipped"]) or not _all_finite((policy, critic))
    if diverged:
        return eqx.tree_at(lambda x: x.frozen, learner, np.array(True)), still
    statistics = learner.statistics
    if learns.normalise_obs:
        statistics = statistics.with_more(_rows(rollout.obs))
    return Learner(policy, adam, critic, statistics, learner.frozen), numbers


def _updated(
    learner: Learner,
    obs: Float[np.ndarray, "time env obs"],
    actions: Float[np.ndarray, "time env action"],
    advantages: Float[np.ndarray, "time env"],
    config: TrainConfig,
    *,
    key: Key[Array, ""],
) -> tuple[GaussianPolicy, optax.OptState | None, UpdateInfo]:
    """The algorithm's update of the policy."""
    learns = config.learns
    if config.algo == "trpo":
        policy, info = _update_trpo(
            learner.policy, _rows(obs), _rows(actions), advantages.ravel(), learns.trpo
        )
        return policy, learner.adam, info
    if learns.ppo.of_steps:
        parts = _rows(obs), _rows(actions), advantages.ravel()
    else:  # whole trajectories: one for each environment
        parts = tuple(np.ascontiguousarray(np.swapaxes(x, 0, 1)) for x in (obs, actions, advantages))
    return _update_ppo(learner.policy, learner.adam, *parts, key, learns.ppo)


_update_trpo = jax.jit(trpo.update, static_argnames="config")


@functools.partial(jax.jit, static_argnames="config")
def _update_ppo(
    policy: GaussianPolicy,
    adam: optax.OptState,
    obs: Float[Array, "sample *time obs"],
    actions: Float[Array, "sample *time action"],
    advantages: Float[Array, "sample *time"],
    key: Key[Array, ""],
    config: PPOConfig,
) -> tuple[GaussianPolicy, optax.OptState, UpdateInfo]:
    log_prob = policy.log_prob(obs, actions)
    return ppo.update(policy, adam, ppo.Batch(obs, actions, advantages, log_prob), config, key=key)


def _seen(
    learner: Learner, obs: Float[np.ndarray, "*batch obs"], config: LearnerConfig
) -> Float[np.ndarray, "*batch obs"]:
    """Observations as the networks get them."""
    return learner.statistics(obs) if config.normalise_obs else obs


def _rows(x: np.ndarray) -> np.ndarray:
    """Lays time and environments end to end."""
    return x.reshape(-1, x.shape[-1])


def _all_finite(tree: Any) -> bool:
    return all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(tree))
