"""The twin of an encoder of pictures: an embedding of states with the same z.

Pictures come first: z is what an objective made of them, and the twin only follows. A controller needs it to
compare simulated states with the goal, and its decoder estimates the state from z.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Key

from planspace.embed.config import FitConfig
from planspace.embed.embedding import Embedding
from planspace.embed.fit import to_numpy
from planspace.embed.gaussian import DiagonalGaussian, kl
from planspace.embed.inputs import Inputs
from planspace.embed.networks import PlanSpaceModel
from planspace.embed.steps import make_optimiser
from planspace.progress import progress

HIDDEN, BATCH = (128, 128), 512
CHUNK = 100
"""Steps of one compiled call."""


def fit_twin(
    inputs: Inputs,
    states: Float[np.ndarray, "row state"],
    mu: Float[np.ndarray, "row z"],
    sigma: Float[np.ndarray, "row z"],
    steps: int,
    seed: int,
) -> Embedding:
    """Fit an encoder of states to z of their pictures, and a decoder of states to that z.

    Args:
        inputs: what the twin's encoder sees of a state.
        states: the states in which the stacks end.
        mu: mean of z of each stack.
        sigma: its standard deviation.
        steps: optimiser steps.
        seed: seed of weights and batches.
    """
    config = FitConfig(hidden=HIDDEN, batch=BATCH, steps=steps, z_dim=mu.shape[1])
    key, step_key = jr.split(jr.key(seed))
    data = _Data(*(jnp.asarray(a, jnp.float32) for a in (inputs(states), mu, sigma)))
    sizes = (data.x.shape[1], config.z_dim, config.hidden, config.sigma_floor)
    model = PlanSpaceModel(*sizes, num_controls=0, key=key)
    carry = model, make_optimiser(config).init(eqx.filter(model, eqx.is_array))
    with progress("twin", steps, unit="step") as bar:
        bar.set_postfix_str("compiling")
        for first in range(0, steps, CHUNK):
            count = min(CHUNK, steps - first)
            carry = _steps(carry, jnp.asarray(first), jnp.asarray(count), step_key, data, config)
            bar.update(count)
            bar.set_postfix_str("", refresh=False)
    return to_numpy(jax.tree.map(lambda a: a[None], carry[0]), 0, inputs, config)


class _Data(NamedTuple):
    """What is fitted: inputs of states, and z of their pictures."""

    x: Float[Array, "row input"]
    mu: Float[Array, "row z"]
    sigma: Float[Array, "row z"]


@eqx.filter_jit
def _steps(
    carry: Any,
    first: Array,
    count: Array,
    key: Key[Array, ""],
    data: _Data,
    config: FitConfig,
) -> Any:
    def loss(model: PlanSpaceModel, rows: Array) -> Array:
        def one(x: Array, mu: Array, sigma: Array) -> Array:
            follows = kl(DiagonalGaussian(mu, sigma), model.encode(x))
            return follows - model.decode(mu).log_prob(x)

        return jnp.mean(jax.vmap(one)(data.x[rows], data.mu[rows], data.sigma[rows]))

    def step(i: Array, carry: Any) -> Any:
        model, state = carry
        rows = jr.randint(jr.fold_in(key, first + i), (config.batch,), 0, len(data.x))
        updates, state = make_optimiser(config).update(eqx.filter_grad(loss)(model, rows), state)
        return eqx.apply_updates(model, updates), state

    return jax.lax.fori_loop(0, count, step, carry)
