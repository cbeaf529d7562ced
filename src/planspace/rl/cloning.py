"""Behaviour cloning: a policy's mean action is brought to the controls of plans."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Key

from planspace.rl.arm import Arm

MINIBATCH, RATE = 256, 1e-3
"""Rows of a minibatch, and the first learning rate of Adam, which decays to 0 along a cosine."""
PENALTY_ROWS = 512
"""Rows from which the penalty of one update of TRPO or PPO is computed."""

Policy = TypeVar("Policy", bound=eqx.Module)
MeanAction = Callable[[Any, Array], Array]
"""(policy, observation) to its mean action."""


class Examples(NamedTuple):
    """Controls of plans, as the mean actions that a policy is to have."""

    obs: Float[Array | np.ndarray, "row obs"]
    """What the policy reads."""
    actions: Float[Array | np.ndarray, "row action"]
    scale: Float[Array | np.ndarray, " action"]
    """Unit in which differences of actions are measured."""
    weight: Float[Array | np.ndarray, ""]
    """Weight of the penalty; not used before training."""

    def drawn(self, num: int, *, key: Key[Array, ""]) -> "Examples":
        """Rows drawn uniformly."""
        rows = jr.randint(key, (num,), 0, len(self.obs))
        return self._replace(obs=jnp.asarray(self.obs)[rows], actions=jnp.asarray(self.actions)[rows])

    def error(self, mean_action: MeanAction, policy: eqx.Module) -> Float[Array, ""]:
        """Mean squared difference of the policy's mean actions from the controls, in units of `scale`."""
        actions = jax.vmap(lambda o: mean_action(policy, o))(self.obs)
        return jnp.mean(((actions - self.actions) / self.scale) ** 2)

    def penalty(self, mean_action: MeanAction, policy: eqx.Module) -> Float[Array, ""]:
        """The error with its weight."""
        return jnp.asarray(self.weight) * self.error(mean_action, policy)


def action_scale(arm: Arm) -> Float[np.ndarray, " action"]:
    """Half of the range of each action or, for actions without limits, the plans' standard deviation."""
    low, high = arm.episodes.action_limits
    assert arm.plan_transitions is not None
    half, spread = (high - low) / 2, np.std(arm.plan_transitions.actions, axis=0)
    return np.where(np.isfinite(half), half, np.where(spread > 0, spread, 1.0)).astype(np.float32)


@eqx.filter_jit
def imitate(
    policy: Policy, mean_action: MeanAction, examples: Examples, num_steps: int, *, key: Key[Array, ""]
) -> Policy:
    """The policy after gradient steps on minibatches of examples.

    Args:
        policy: the policy.
        mean_action: computes its mean action.
        examples: what it is to do.
        num_steps: number of gradient steps.
        key: random key of the minibatches.
    """
    adam = optax.adam(optax.cosine_decay_schedule(RATE, num_steps))

    def step(carry: tuple, step_key: Key[Array, ""]) -> tuple[tuple, None]:
        policy, state = carry
        batch = examples.drawn(MINIBATCH, key=step_key)
        updates, state = adam.update(jax.grad(lambda p: batch.error(mean_action, p))(policy), state)
        return (eqx.apply_updates(policy, updates), state), None

    first = policy, adam.init(eqx.filter(policy, eqx.is_array))
    (cloned, _), _ = jax.lax.scan(step, first, jr.split(key, num_steps))
    return cloned
