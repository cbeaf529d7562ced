"""One update of PPO: proximal policy optimisation with a clipped ratio (Schulman et al. 2017).

A minibatch consists of samples. A sample is a step, or a whole trajectory with an axis of time after the axis
of samples. The loss is a mean over steps in both cases.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from planspace.embed.gaussian import kl
from planspace.rl.agent import AgentState, ImproveFn, Improvement, Samples
from planspace.rl.algorithm import Diverged
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.cloning import Examples
from planspace.rl.policy import GaussianPolicy, UpdateInfo, mean_action


class Batch(eqx.Module):
    """Samples of one iteration."""

    obs: Float[Array, "sample *time obs"]
    actions: Float[Array, "sample *time action"]
    advantages: Float[Array, "sample *time"]
    log_prob: Float[Array, "sample *time"]
    """Log-density of the actions under the policy that took them [nat]."""


def optimiser(config: PPO) -> optax.GradientTransformation:
    """Adam, with clipped gradients if `clip_norm` is set."""
    adam = optax.adam(config.learning_rate)
    return (
        adam if config.clip_norm is None else optax.chain(optax.clip_by_global_norm(config.clip_norm), adam)
    )


def improve(config: PPO) -> ImproveFn:
    """The update of PPO with these hyper-parameters."""

    def step(state: AgentState, samples: Samples, key: Key[Array, ""]) -> Improvement:
        obs, actions, advantages, examples = samples
        if config.of_steps:
            parts = obs.reshape(-1, obs.shape[-1]), actions.reshape(-1, actions.shape[-1]), advantages.ravel()
        else:  # whole trajectories: one for each environment
            parts = tuple(np.ascontiguousarray(np.swapaxes(x, 0, 1)) for x in samples[:3])
        policy, adam, info = _update(state.policy, state.optimiser, parts, key, config, examples)
        if info.skipped:
            raise Diverged
        return policy, adam, info

    return step


def update(
    policy: GaussianPolicy,
    adam: optax.OptState,
    batch: Batch,
    config: PPO,
    examples: Examples | None = None,
    *,
    key: Key[Array, ""],
) -> tuple[GaussianPolicy, optax.OptState, UpdateInfo]:
    """Several epochs of minibatches over the samples of one iteration.

    If a number is not finite, policy and optimiser stay unchanged. With examples, their penalty is added to
    the loss.
    """
    before = loss(policy, batch, config.clip, examples)

    def one_epoch(carry: tuple, epoch_key: Key[Array, ""]) -> tuple[tuple, None]:
        (old_policy, old_adam), last, epochs, done = carry
        new = _epoch(old_policy, old_adam, batch, config, examples, key=epoch_key)
        now = loss(new[0], batch, config.clip, examples) if config.tolerance else last
        kept = jax.tree.map(lambda a, b: jnp.where(done, a, b), (old_policy, old_adam), new)
        epochs += ~done
        done |= (config.tolerance > 0) & (jnp.abs(last - now) < config.tolerance)
        return (kept, jnp.where(done, last, now), epochs, done), None

    first = ((policy, adam), jnp.where(config.tolerance > 0, jnp.inf, before), jnp.array(0), jnp.array(False))
    ((trained, trained_adam), _, epochs, _), _ = jax.lax.scan(one_epoch, first, jr.split(key, config.epochs))
    rows = batch.obs.reshape(-1, batch.obs.shape[-1])
    mean_kl = jnp.mean(jax.vmap(lambda o: kl(policy(o), trained(o)))(rows))
    after = loss(trained, batch, config.clip, examples)
    leaves = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves((trained, trained_adam))]
    usable = jnp.isfinite(after) & jnp.stack(leaves).all()
    chosen, chosen_adam = jax.tree.map(
        lambda a, b: jnp.where(usable, b, a), (policy, adam), (trained, trained_adam)
    )
    info = UpdateInfo(
        kl=jnp.where(usable, mean_kl, 0.0),
        loss=jnp.where(usable, after, before),
        improvement=jnp.where(usable, before - after, 0.0),
        entropy=chosen.entropy(),
        rounds=epochs,
        skipped=~usable,
    )
    return chosen, chosen_adam, info


@functools.partial(jax.jit, static_argnames="config")
def _update(
    policy: GaussianPolicy,
    adam: optax.OptState,
    samples: tuple[Array, Array, Array],
    key: Key[Array, ""],
    config: PPO,
    examples: Examples | None,
) -> tuple[GaussianPolicy, optax.OptState, UpdateInfo]:
    """Update from (observations, actions, advantages)."""
    obs, actions, advantages = samples
    log_prob = policy.log_prob(obs, actions)
    return update(policy, adam, Batch(obs, actions, advantages, log_prob), config, examples, key=key)


def loss(
    policy: GaussianPolicy, batch: Batch, clip: float, examples: Examples | None = None
) -> Float[Array, ""]:
    """Negative clipped surrogate objective, and the penalty of examples if there are any.

    Source: Schulman et al. 2017, equation 7.
    """
    ratio = jnp.exp(policy.log_prob(batch.obs, batch.actions) - batch.log_prob)
    clipped = jnp.clip(ratio, 1 - clip, 1 + clip)
    negative = -jnp.mean(jnp.minimum(ratio * batch.advantages, clipped * batch.advantages))
    return negative if examples is None else negative + examples.penalty(mean_action, policy)


def minibatch_step(
    policy: GaussianPolicy,
    adam: optax.OptState,
    batch: Batch,
    config: PPO,
    examples: Examples | None = None,
) -> tuple[GaussianPolicy, optax.OptState]:
    """One step of the optimiser."""
    gradient = jax.grad(loss)(policy, batch, config.clip, examples)
    updates, adam = optimiser(config).update(gradient, adam)
    return eqx.apply_updates(policy, updates), adam


def _epoch(
    policy: GaussianPolicy,
    adam: optax.OptState,
    batch: Batch,
    config: PPO,
    examples: Examples | None = None,
    *,
    key: Key[Array, ""],
) -> tuple[GaussianPolicy, optax.OptState]:
    """Use all samples once in a random order; the last minibatch may be smaller."""
    num = len(batch.advantages)
    size = min(config.minibatch, num)
    order = jr.permutation(key, num)
    whole = num // size * size

    def step(carry: tuple, rows: Int[Array, " sample"]) -> tuple[tuple, None]:
        policy, adam = carry
        return minibatch_step(policy, adam, jax.tree.map(lambda x: x[rows], batch), config, examples), None

    carry, _ = jax.lax.scan(step, (policy, adam), order[:whole].reshape(-1, size))
    return step(carry, order[whole:])[0] if whole < num else carry
