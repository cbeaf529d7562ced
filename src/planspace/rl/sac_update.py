"""The gradient step of soft actor-critic: critics, policy, temperature and target critics.

Notation of Haarnoja et al. 2018: pi is the policy, Q the critics, alpha the temperature. An action here is
squashed by tanh, so each of its numbers lies within (-1, 1); `sac_agent` scales it to the task's limits.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import optax
from jaxtyping import Array, Bool, Float, Key

from planspace.embed.gaussian import DiagonalGaussian
from planspace.rl.algorithms.sac import SAC
from planspace.rl.cloning import Examples
from planspace.rl.mlp import MLP

LOG_STD_LIMITS = -20.0, 2.0
"""The logarithm of the policy's standard deviation is clipped to these, as in the authors' code."""
SQUASH_FLOOR = 1e-6
"""Added to the derivative of tanh, so that its logarithm is finite; the number of the authors' code."""


class Batch(NamedTuple):
    """Steps, each a row."""

    policy_obs: Float[Array, "row obs"]
    """What the policy observes before the step."""
    critic_obs: Float[Array, "row critic_obs"]
    """What the critics observe before the step."""
    actions: Float[Array, "row action"]
    rewards: Float[Array, " row"]
    next_policy_obs: Float[Array, "row obs"]
    next_critic_obs: Float[Array, "row critic_obs"]
    terminated: Bool[Array, " row"]


class Noise(NamedTuple):
    """Unit Gaussian noise of the actions that the policy draws in a gradient step."""

    now: Float[Array, "row action"]
    """For the states before the steps."""
    then: Float[Array, "row action"]
    """For the states after them."""


class Learner(eqx.Module):
    """What gradient steps change."""

    actor: MLP
    """From the observation to the mean and the logarithm of the standard deviation."""
    critics: tuple[MLP, MLP]
    targets: tuple[MLP, MLP]
    log_alpha: Float[Array, ""]
    optimisers: tuple[optax.OptState, optax.OptState, optax.OptState]
    """Adam's state of policy, critics and temperature."""


class UpdateInfo(NamedTuple):
    """Numbers of a gradient step."""

    critic_loss: Float[Array, ""]
    """Half the squared error of the critics, summed over both."""
    actor_loss: Float[Array, ""]
    temperature: Float[Array, ""]
    entropy: Float[Array, ""]
    """Estimated entropy of the policy [nat]."""
    value: Float[Array, ""]
    """Mean of the targets of the critics."""


def new_learner(
    settings: SAC, num_policy_obs: int, num_critic_obs: int, num_actions: int, *, key: Key[Array, ""]
) -> Learner:
    """Draw the weights; the target critics equal the critics."""
    actor_key, *critic_keys = jr.split(key, 3)
    actor = MLP((num_policy_obs, *settings.hidden, 2 * num_actions), activation="relu", key=actor_key)
    sizes = (num_critic_obs + num_actions, *settings.critic_hidden, 1)
    first, second = (
        MLP(sizes, layer_norm=settings.layer_norm, activation="relu", key=key) for key in critic_keys
    )
    log_alpha = jnp.log(jnp.asarray(settings.temperature, jnp.float32))
    optimised = (eqx.filter(part, eqx.is_array) for part in (actor, (first, second), log_alpha))
    of_actor, of_critics, of_alpha = map(_adam(settings).init, optimised)
    return Learner(actor, (first, second), (first, second), log_alpha, (of_actor, of_critics, of_alpha))


def sample(
    actor: MLP, obs: Float[Array, " obs"], noise: Float[Array, " action"]
) -> tuple[Float[Array, " action"], Float[Array, ""]]:
    """An action drawn from the policy, and its log-density [nat]."""
    mean, log_std = jnp.split(actor(obs), 2)
    gaussian = DiagonalGaussian(mean, jnp.exp(jnp.clip(log_std, *LOG_STD_LIMITS)))
    before = gaussian.mu + gaussian.sigma * noise
    action = jnp.tanh(before)
    return action, gaussian.log_prob(before) - jnp.sum(jnp.log(1.0 - action**2 + SQUASH_FLOOR))


def mean_action(actor: MLP, obs: Float[Array, " obs"]) -> Float[Array, " action"]:
    """The mean of the policy, squashed."""
    mean, _ = jnp.split(actor(obs), 2)
    return jnp.tanh(mean)


def critic_targets(
    settings: SAC, learner: Learner, batch: Batch, noise: Float[Array, "row action"]
) -> Float[Array, " row"]:
    """The values to which the critics are fitted.

    A termination ends the sum of rewards; a time limit does not.
    """
    actions, log_prob = _samples(learner.actor, batch.next_policy_obs, noise)
    value = _least_value(learner.targets, batch.next_critic_obs, actions)
    value = value - jnp.exp(learner.log_alpha) * log_prob
    return batch.rewards + settings.discount * jnp.where(batch.terminated, 0.0, value)


def gradient_step(
    settings: SAC, learner: Learner, batch: Batch, noise: Noise, examples: Examples | None = None
) -> tuple[Learner, UpdateInfo]:
    """Improve everything once, in the order of Stable-Baselines3.

    The temperature that multiplies entropies is the one before the step. With examples, their penalty is
    added to the loss of the policy.
    """
    adam, alpha = _adam(settings), jnp.exp(learner.log_alpha)
    actor_state, critic_state, alpha_state = learner.optimisers
    targets = critic_targets(settings, learner, batch, noise.then)

    def critic_loss(critics: tuple[MLP, MLP]) -> Array:
        values = _values(critics, batch.critic_obs, batch.actions)
        return 0.5 * jnp.sum(jnp.mean((values - targets) ** 2, axis=1))

    of_critics, gradient = jax.value_and_grad(critic_loss)(learner.critics)
    change, critic_state = adam.update(gradient, critic_state)
    critics = eqx.apply_updates(learner.critics, change)

    def actor_loss(actor: MLP) -> tuple[Array, Array]:
        actions, log_prob = _samples(actor, batch.policy_obs, noise.now)
        loss = jnp.mean(alpha * log_prob - _least_value(critics, batch.critic_obs, actions))
        return loss if examples is None else loss + examples.penalty(mean_action, actor), log_prob

    (of_actor, log_prob), gradient = jax.value_and_grad(actor_loss, has_aux=True)(learner.actor)
    change, actor_state = adam.update(gradient, actor_state)
    actor = eqx.apply_updates(learner.actor, change)

    target_entropy = settings.target_entropy
    wanted = -batch.actions.shape[1] if target_entropy is None else target_entropy
    entropy = -jnp.mean(log_prob)
    change, alpha_state = adam.update(entropy - wanted, alpha_state)
    log_alpha = eqx.apply_updates(learner.log_alpha, change)

    tau = settings.polyak
    followed = jax.tree.map(lambda x, target: tau * x + (1.0 - tau) * target, critics, learner.targets)
    new = Learner(actor, critics, followed, log_alpha, (actor_state, critic_state, alpha_state))
    return new, UpdateInfo(of_critics, of_actor, alpha, entropy, jnp.mean(targets))


def _adam(settings: SAC) -> optax.GradientTransformation:
    return optax.adam(settings.learning_rate)


def _samples(
    actor: MLP, obs: Float[Array, "row obs"], noise: Float[Array, "row action"]
) -> tuple[Float[Array, "row action"], Float[Array, " row"]]:
    return jax.vmap(sample, in_axes=(None, 0, 0))(actor, obs, noise)


def _values(
    critics: tuple[MLP, MLP], obs: Float[Array, "row obs"], actions: Float[Array, "row action"]
) -> Float[Array, "critic row"]:
    inputs = jnp.concatenate([obs, actions], axis=1)
    return jnp.stack([jax.vmap(critic)(inputs)[:, 0] for critic in critics])


def _least_value(
    critics: tuple[MLP, MLP], obs: Float[Array, "row obs"], actions: Float[Array, "row action"]
) -> Float[Array, " row"]:
    return jnp.min(_values(critics, obs, actions), axis=0)
