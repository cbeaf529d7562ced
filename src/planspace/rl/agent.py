"""Policy and critic of one seed, and how TRPO and PPO update them from an iteration of episodes.

Everything here is written for one seed. Training updates the seeds in parallel threads: measured on two cores
this takes 0.5 to 0.7 of the time of one program with an axis of seeds. The result of a seed does not depend,
bit for bit, on the number of seeds.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Key

from planspace.rl.advantage import discounted_returns, gae
from planspace.rl.algorithm import Diverged
from planspace.rl.algorithms.on_policy import OnPolicy
from planspace.rl.arm import Arm
from planspace.rl.cloning import PENALTY_ROWS, Examples, action_scale, imitate
from planspace.rl.critic import Critic, make_critic
from planspace.rl.normalise import ObsStatistics
from planspace.rl.observe import Observer
from planspace.rl.policy import UNIT_ENTROPY, GaussianPolicy, UpdateInfo, mean_action
from planspace.rl.policy_network import Actor, PolicyNetwork
from planspace.rl.rollout import Rollout


class AgentState(eqx.Module):
    """The state of one seed."""

    policy: GaussianPolicy
    optimiser: optax.OptState | None
    """State of the policy's optimiser; None if the algorithm has no optimiser."""
    critic: Critic
    statistics: ObsStatistics
    """Mean and standard deviation of observations; empty unless `normalise_obs` is set."""


class Samples(NamedTuple):
    """The samples of an iteration from which a policy is improved."""

    obs: Float[np.ndarray, "time env obs"]
    actions: Float[np.ndarray, "time env action"]
    advantages: Float[np.ndarray, "time env"]
    examples: Examples | None = None
    """Controls of plans, for a penalty; None without."""


RECORDED = ("kl", "entropy", "loss", "improvement", "skipped")
"""Fields of `UpdateInfo` that the history contains."""
Improvement = tuple[GaussianPolicy, optax.OptState | None, UpdateInfo]
ImproveFn = Callable[[AgentState, Samples, Array], Improvement]
"""(state, samples, random key) to the new policy and optimiser state, and what the update did."""


def new_agent(
    settings: OnPolicy,
    arm: Arm,
    *,
    key: Key[Array, ""],
    optimiser: optax.GradientTransformation | None = None,
) -> AgentState:
    """The state of a seed before training.

    Args:
        settings: hyper-parameters.
        arm: what is trained on.
        key: random key of the first weights.
        optimiser: optimises the policy, if the algorithm has an optimiser.
    """
    num_policy, num_critic = arm.num_policy_obs, arm.observer.num_critic_obs
    hidden = matched(settings.hidden, num_policy, num_policy + settings.match_z, arm.num_actions)
    critic_hidden = matched(settings.critic_hidden, num_critic, num_critic + settings.match_z, 1)
    policy = GaussianPolicy(
        num_policy,
        arm.num_actions,
        hidden=hidden,
        layer_norm=settings.layer_norm,
        std=settings.initial_std,
        key=key,
    )
    return AgentState(
        policy=policy,
        optimiser=optimiser.init(eqx.filter(policy, eqx.is_array)) if optimiser else None,
        critic=make_critic(settings.critic, num_critic, critic_hidden, key=jr.fold_in(key, 0)),
        statistics=ObsStatistics.empty(arm.observer.num_obs),
    )


def matched(hidden: tuple[int, ...], num_obs: int, num_more: int, num_outputs: int) -> tuple[int, ...]:
    """Widen hidden layers until a network has as many parameters as one with more inputs.

    Args:
        hidden: units of the hidden layers of the network with more inputs.
        num_obs: inputs of the network that is widened.
        num_more: inputs of the other network.
        num_outputs: outputs of both.

    Returns:
        `hidden`, each layer wider by the same number of units: the smallest network with at least as many
        parameters.
    """

    def count(sizes: tuple[int, ...]) -> int:
        return sum((a + 1) * b for a, b in itertools.pairwise(sizes))

    wanted, extra = count((num_more, *hidden, num_outputs)), 0
    while count((num_obs, *(n + extra for n in hidden), num_outputs)) < wanted:
        extra += 1
    return tuple(n + extra for n in hidden)


def clone(settings: OnPolicy, arm: Arm, state: AgentState, *, key: Key[Array, ""]) -> AgentState:
    """The state after gradient steps that bring the mean action to the controls of plans.

    From then on, observations are standardised as those of the plans. The standard deviation of actions does
    not change.
    """
    assert arm.plan_transitions is not None
    statistics = state.statistics
    if settings.normalise_obs:
        statistics = ObsStatistics.of(arm.plan_transitions.obs)
    seen = AgentState(state.policy, state.optimiser, state.critic, statistics)
    examples = _examples(settings, arm, seen)
    policy = imitate(state.policy, mean_action, examples, arm.config.clone, key=key)
    return AgentState(policy, state.optimiser, state.critic, statistics)


def collect(
    settings: OnPolicy, arm: Arm, states: Sequence[AgentState], rngs: Sequence[np.random.Generator]
) -> Rollout:
    """Episodes of all seeds, with actions drawn from their policies."""
    actor = Actor([act(settings, state) for state in states], arm.observer.policy_columns)
    return arm.rollout(actor, rngs, discount=settings.discount, bootstrap_timeout=settings.bootstrap_timeout)


def act(settings: OnPolicy, state: AgentState) -> PolicyNetwork:
    """The network of the mean action."""
    return state.policy.network(state.statistics if settings.normalise_obs else None)


def update(
    settings: OnPolicy,
    improve: ImproveFn,
    arm: Arm,
    state: AgentState,
    rollout: Rollout,
    *,
    key: Key[Array, ""],
) -> tuple[AgentState, dict[str, float]]:
    """The state after an iteration, and numbers of the update for the history.

    Args:
        settings: hyper-parameters.
        improve: the algorithm's own update of the policy.
        arm: what is trained on.
        state: the state of the seed.
        rollout: the episodes of the seed.
        key: random key of the minibatches.

    Raises:
        Diverged: advantages or returns are not finite.
    """
    policy_key, critic_key = jr.split(key)
    value, next_value = values(settings, state, rollout, arm.observer)
    advantages, returns = estimates(settings, state.policy, rollout, value, next_value)
    obs = _inputs(settings, state, rollout.obs)
    samples = Samples(obs[..., arm.observer.policy_columns], rollout.actions, advantages)
    if arm.clone_weight > 0:
        drawn = _examples(settings, arm, state).drawn(PENALTY_ROWS, key=jr.fold_in(key, 0))
        samples = samples._replace(examples=drawn)
    policy, optimiser, info = improve(state, samples, policy_key)
    critic = state.critic.fitted(
        _rows(obs[..., arm.observer.critic_columns]), rollout.step.ravel(), returns.ravel(), key=critic_key
    )
    statistics = state.statistics
    if settings.normalise_obs and not arm.config.clone:
        statistics = statistics.with_more(_rows(rollout.obs))
    numbers = {
        name: float(getattr(info, name)) for name in ("kl", "entropy", "loss", "improvement", "skipped")
    }
    numbers["explained_variance"] = explained_variance(returns, value)
    return AgentState(policy, optimiser, critic, statistics), numbers


def values(
    settings: OnPolicy, state: AgentState, rollout: Rollout, observer: Observer
) -> tuple[Float[np.ndarray, "time env"], Float[np.ndarray, "time env"]]:
    """The critic's value before and after each step; after a step that ends an episode for good, 0.

    The next state is mostly the next row's. It is not where the record is cut, nor at the time limit, beyond
    which the 2020 runs counted nothing.

    Args:
        settings: whether the value at the time limit counts.
        state: the state of the seed.
        rollout: the episodes of the seed.
        observer: which columns the critic reads.
    """

    def value_of(obs: np.ndarray, step: np.ndarray) -> np.ndarray:
        return state.critic.values(_inputs(settings, state, obs)[..., observer.critic_columns], step)

    value = value_of(rollout.obs, rollout.step)
    next_value = np.zeros_like(value)
    next_value[:-1] = value[1:]
    next_value[rollout.timeout | rollout.terminated] = 0.0
    inside = rollout.cut | (rollout.timeout & settings.bootstrap_timeout)
    next_value[inside] = value_of(rollout.next_obs[inside], rollout.step[inside] + 1)
    return value, next_value


def estimates(
    settings: OnPolicy,
    policy: GaussianPolicy,
    rollout: Rollout,
    value: Float[np.ndarray, "time env"],
    next_value: Float[np.ndarray, "time env"],
) -> tuple[Float[np.ndarray, "time env"], Float[np.ndarray, "time env"]]:
    """Advantages of the actions taken (float32), and the discounted returns to which the critic is fitted.

    Raises:
        Diverged: a number is not finite.
    """
    ends = rollout.terminated, rollout.timeout | rollout.cut
    paid = rollout.rewards + rollout.shaping
    with np.errstate(invalid="ignore", over="ignore"):
        advantages = gae(
            paid + settings.entropy_reward * np.sum(np.asarray(policy.log_std) + UNIT_ENTROPY),
            value,
            next_value,
            *ends,
            discount=settings.discount,
            gae_lambda=settings.gae_lambda,
        )
        returns = discounted_returns(paid, next_value, *ends, discount=settings.discount)
    if not (np.isfinite(advantages).all() and np.isfinite(returns).all()):
        raise Diverged
    if settings.normalise_advantages:
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    return advantages.astype(np.float32), returns


def explained_variance(returns: Float[np.ndarray, "time env"], value: Float[np.ndarray, "time env"]) -> float:
    """Fraction of the returns' variance that the critic predicted."""
    return float(1.0 - np.var(returns - value) / max(np.var(returns), 1e-12))


def _inputs(
    settings: OnPolicy, state: AgentState, obs: Float[np.ndarray, "*batch obs"]
) -> Float[np.ndarray, "*batch obs"]:
    """The inputs of the networks: observations, standardised if `normalise_obs` is set."""
    return state.statistics(obs) if settings.normalise_obs else obs


def _examples(settings: OnPolicy, arm: Arm, state: AgentState) -> Examples:
    """The controls of plans as the policy of a seed is to imitate them."""
    steps = arm.plan_transitions
    assert steps is not None
    obs = _inputs(settings, state, steps.obs)[:, arm.observer.policy_columns]
    return Examples(obs, steps.actions, action_scale(arm), np.asarray(arm.clone_weight, np.float32))


def _rows(x: np.ndarray) -> np.ndarray:
    """Merge the axes of time and environments."""
    return x.reshape(-1, x.shape[-1])
