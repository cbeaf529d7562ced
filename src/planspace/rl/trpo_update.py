"""One update of TRPO: trust region policy optimisation (Schulman et al. 2015).

Notation: g is the gradient of the surrogate objective, F the Fisher matrix of the policy, s = F^-1 g the
search direction. A step is sqrt(2 max_kl / s F s) s, shortened until the surrogate improves within max_kl.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, Key

from planspace.embed.gaussian import kl
from planspace.rl.agent import AgentState, ImproveFn, Improvement, Samples
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.cloning import Examples
from planspace.rl.policy import GaussianPolicy, UpdateInfo, mean_action


def improve(config: TRPO) -> ImproveFn:
    """The update of TRPO with these hyper-parameters."""

    def step(state: AgentState, samples: Samples, key: Key[Array, ""]) -> Improvement:
        obs, actions = (x.reshape(-1, x.shape[-1]) for x in (samples.obs, samples.actions))
        policy, info = _update(
            state.policy, obs, actions, samples.advantages.ravel(), config, samples.examples
        )
        return policy, state.optimiser, info

    return step


def update(
    policy: GaussianPolicy,
    obs: Float[Array, "sample obs"],
    actions: Float[Array, "sample action"],
    advantages: Float[Array, " sample"],
    config: TRPO,
    examples: Examples | None = None,
) -> tuple[GaussianPolicy, UpdateInfo]:
    """Update a policy from the samples of one iteration.

    With examples, their penalty is subtracted from the surrogate objective.
    """
    theta, rebuild = ravel_pytree(policy)
    old = jax.vmap(policy)(obs)
    old_log_prob = jax.vmap(lambda d, a: d.log_prob(a))(old, actions)

    def surrogate_and_kl(theta: Array) -> tuple[Array, Array]:
        new = jax.vmap(rebuild(theta))(obs)
        log_prob = jax.vmap(lambda d, a: d.log_prob(a))(new, actions)
        surrogate = jnp.mean(jnp.exp(log_prob - old_log_prob) * advantages)
        if examples is not None:
            surrogate -= examples.penalty(mean_action, rebuild(theta))
        return surrogate, jnp.mean(jax.vmap(kl)(old, new))

    before, gradient = jax.value_and_grad(lambda t: surrogate_and_kl(t)[0])(theta)
    fisher = fisher_product(rebuild, theta, obs)
    direction = conjugate_gradient(lambda v: fisher(v) + config.cg_damping * v, gradient, config.cg_steps)
    curvature = direction @ (fisher(direction) + config.cg_damping * direction)
    usable = jnp.isfinite(curvature) & (curvature > 0) & jnp.isfinite(gradient).all()
    full_step = jnp.sqrt(2 * config.max_kl / jnp.where(usable, curvature, 1.0)) * direction

    def try_step(k: Array) -> tuple[Array, Array, Array, Array]:
        candidate = theta + config.backtrack_ratio**k * full_step
        surrogate, mean_kl = surrogate_and_kl(candidate)
        accepted = (surrogate > before) & (mean_kl <= config.max_kl)  # false for NaN
        return candidate, surrogate - before, mean_kl, accepted

    k, (candidate, improvement, mean_kl, accepted) = line_search(try_step, usable, config.max_backtracks)
    accepted &= usable
    chosen = rebuild(jnp.where(accepted, candidate, theta))
    info = UpdateInfo(
        kl=jnp.where(accepted, mean_kl, 0.0),
        loss=-(before + jnp.where(accepted, improvement, 0.0)),
        improvement=jnp.where(accepted, improvement, 0.0),
        entropy=chosen.entropy(),
        rounds=k + 1,
        skipped=~accepted,
    )
    return chosen, info


_update = jax.jit(update, static_argnames="config")


def line_search(
    try_step: Callable[[Array], tuple[Array, Array, Array, Array]],
    usable: Bool[Array, ""],
    max_backtracks: int,
) -> tuple[Int[Array, ""], tuple[Array, Array, Array, Array]]:
    """Try shorter and shorter steps until one is accepted.

    Args:
        try_step: the number of a step to the parameters after it, improvement, KL and whether it is accepted.
        usable: whether to search at all.
        max_backtracks: largest number of steps to try.

    Returns:
        The number of the last step tried, and its result.
    """

    def search_on(state: tuple) -> Array:
        k, (_, _, _, accepted) = state
        return ~accepted & (k + 1 < max_backtracks) & usable

    def shorten(state: tuple) -> tuple:
        k, _ = state
        return k + 1, try_step(k + 1)

    first = jnp.array(0)
    return jax.lax.while_loop(search_on, shorten, (first, try_step(first)))


def fisher_product(
    rebuild: Callable[[Array], GaussianPolicy],
    theta: Float[Array, " parameter"],
    obs: Float[Array, "sample obs"],
) -> Callable[[Array], Array]:
    """The function v -> F v, with F the mean Fisher matrix over observations: the Hessian of the mean KL.

    With J the Jacobian of (mean, log_std), F = J' diag(1 / sigma^2, 2) J. This is exact, and cheaper than
    differentiating the KL twice.
    """

    def outputs(theta: Array) -> tuple[Array, Array]:
        policy = rebuild(theta)
        return jax.vmap(lambda o: policy.mean(o))(obs), policy.log_std

    (_, log_std), push = jax.linearize(outputs, theta)
    pull = jax.linear_transpose(push, theta)
    precision = jnp.exp(-2 * log_std)

    def product(v: Array) -> Array:
        d_mean, d_log_std = push(v)
        return pull((d_mean * precision / len(obs), 2 * d_log_std))[0]

    return product


def conjugate_gradient(
    product: Callable[[Array], Array], b: Float[Array, " n"], steps: int
) -> Float[Array, " n"]:
    """Solve A x = b for a positive definite A, given as the function v -> A v."""

    def one_step(state: tuple, _: None) -> tuple[tuple, None]:
        x, r, p, rr = state
        ap = product(p)
        alpha = rr / jnp.maximum(p @ ap, 1e-30)
        x, r = x + alpha * p, r - alpha * ap
        new_rr = r @ r
        p = r + new_rr / jnp.maximum(rr, 1e-30) * p
        return (x, r, p, new_rr), None

    (x, _, _, _), _ = jax.lax.scan(one_step, (jnp.zeros_like(b), b, b, b @ b), length=steps)
    return x
