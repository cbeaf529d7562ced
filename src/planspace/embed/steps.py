"""Optimiser steps of all seeds at once, compiled; the only place with an axis of seeds."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Int, Key

from planspace.embed.config import FitConfig
from planspace.embed.losses import Terms, read_out
from planspace.embed.networks import PlanSpaceModel
from planspace.embed.objective import Objective, split_loss
from planspace.embed.samples import Sample, Samples
from planspace.embed.tracing import uses_decoder
from planspace.workers import count_cores


class TrainState(eqx.Module):
    """Everything that changes during training, with a leading axis of seeds."""

    model: PlanSpaceModel
    optimiser: Any
    average: PlanSpaceModel | None
    """Running average of the model, if there is one."""

    @property
    def result(self) -> PlanSpaceModel:
        """The model that is measured and saved."""
        return self.model if self.average is None else self.average


def seed_groups(num_seeds: int) -> list[slice]:
    """Divide the seeds into groups that are trained together: two or three seeds on a CPU, otherwise all.

    XLA makes little use of a second core on networks this small; threads with a group each do. The groups do
    not depend on the number of cores, because rounding may depend on the size of a group.
    """
    device = jax.config.jax_default_device or jax.devices()[0]
    count = -(-num_seeds // 3) if device.platform == "cpu" else 1
    edges = [round(i * num_seeds / count) for i in range(count + 1)]
    return [slice(a, b) for a, b in pairwise(edges)]


@eqx.filter_jit
def init(keys: Key[Array, " seed"], samples: Samples, config: FitConfig) -> TrainState:
    """Draw fresh weights for each seed."""

    def init_one(key: Key[Array, ""]) -> TrainState:
        model = _new_model(key, samples, config)
        optimiser = make_optimiser(config).init(eqx.filter(model, eqx.is_array))
        return TrainState(model, optimiser, model if config.average else None)

    return eqx.filter_vmap(init_one)(keys)


def check_loss(samples: Samples, config: FitConfig) -> None:
    """Trace the objective's loss on one sample, without compiling it.

    Raises:
        UsageError: the loss raises an exception, or does not return what `Objective.loss` requires.
    """
    key = jr.key(0)
    model = eqx.filter_eval_shape(_new_model, key, samples, config)
    batch = eqx.filter_eval_shape(samples.draw, key, 1)
    one = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), batch)
    uses_decoder(config.objective, model, one, key)


def make_advance(
    keys: Key[Array, " seed"], samples: Samples, config: FitConfig, chunk: int
) -> Callable[[TrainState, int, int], tuple[TrainState, Terms]]:
    """Return `run_steps` for any number of seeds, with the groups distributed over threads."""
    groups = seed_groups(len(keys))
    pool = ThreadPoolExecutor(min(len(groups), count_cores()))

    def advance(state: TrainState, first: int, count: int) -> tuple[TrainState, Terms]:
        def advance_group(group: slice) -> Any:
            part = jax.tree.map(lambda a: np.asarray(a)[group], state)
            # arrays, because Python numbers would be compiled in
            done = run_steps(part, jnp.array(first), jnp.array(count), keys[group], samples, config, chunk)
            return jax.tree.map(np.asarray, done)

        parts = pool.map(advance_group, groups)
        return jax.tree.map(lambda *leaves: jnp.asarray(np.concatenate(leaves)), *parts)

    return advance


@eqx.filter_jit
def run_steps(
    state: TrainState,
    first: Int[Array, ""],
    count: Int[Array, ""],
    keys: Key[Array, " seed"],
    samples: Samples,
    config: FitConfig,
    chunk: int,
) -> tuple[TrainState, Terms]:
    """Take optimiser steps first .. first + count - 1 for all seeds.

    It is compiled once for every count up to `chunk`. The randomness of a step depends only on its seed and
    its number.

    Returns:
        The state after the steps, and each term [seed, chunk]; only the first `count` columns are filled.
    """

    def one_seed(state: TrainState, seed_key: Key[Array, ""]) -> tuple[TrainState, Terms]:
        def body(i: Array, carry: tuple[TrainState, Terms]) -> tuple[TrainState, Terms]:
            state, history = carry
            state, terms = _one_step(state, first + i, seed_key, samples, config)
            return state, jax.tree.map(lambda past, now: past.at[i].set(now), history, terms)

        _, shapes = eqx.filter_eval_shape(_one_step, state, first, seed_key, samples, config)
        history = {name: jnp.full(chunk, jnp.nan, shape.dtype) for name, shape in shapes.items()}
        return jax.lax.fori_loop(0, count, body, (state, history))

    return eqx.filter_vmap(one_seed)(state, keys)


def _one_step(
    state: TrainState, step: Array, seed_key: Key[Array, ""], samples: Samples, config: FitConfig
) -> tuple[TrainState, Terms]:
    batch_key, noise_key = jr.split(jr.fold_in(seed_key, step))
    batch = samples.draw(batch_key, config.batch)
    gradient, terms = eqx.filter_grad(_batch_loss, has_aux=True)(state.model, batch, noise_key, config)
    updates, optimiser = make_optimiser(config).update(gradient, state.optimiser)
    model = eqx.apply_updates(state.model, updates)
    average = None
    if state.average is not None:
        average = jax.tree.map(
            lambda old, new: config.average * old + (1 - config.average) * new, state.average, model
        )
    return TrainState(model, optimiser, average), terms


def _batch_loss(
    model: PlanSpaceModel, batch: Sample, key: Key[Array, ""], config: FitConfig
) -> tuple[Array, Terms]:
    keys = jr.split(key, config.batch)
    terms = jax.vmap(lambda sample, key: sample_terms(config.objective, model, sample, key=key))(batch, keys)
    means = jax.tree.map(jnp.mean, terms)
    return -means["bound"], means


def sample_terms(
    objective: Objective, model: PlanSpaceModel, sample: Sample, *, key: Key[Array, ""]
) -> Terms:
    """Compute what is maximised for one sample, `bound`, and the objective's terms.

    The bound is minus the loss. If the loss does not depend on the decoder, the bound also contains the
    likelihood of the states given the means of their z, whose gradient moves only the decoder.
    """
    loss, terms = split_loss(objective.loss(model, sample, key=key))
    trains_decoder = uses_decoder(objective, model, sample, key)
    bound = -jnp.asarray(loss) if trains_decoder else read_out(model, sample.x) - loss
    return {"bound": bound, **{name: jnp.asarray(term) for name, term in terms.items()}}


def _new_model(key: Key[Array, ""], samples: Samples, config: FitConfig) -> PlanSpaceModel:
    sizes = (samples.inputs.shape[1], config.z_dim, config.hidden, config.sigma_floor)
    return PlanSpaceModel(*sizes, num_controls=samples.controls.shape[1], key=key)


def make_optimiser(config: FitConfig) -> optax.GradientTransformation:
    """Adam, with the gradient clipped and the learning rate scheduled as the settings say."""
    rate = (
        optax.cosine_decay_schedule(config.learning_rate, config.steps)
        if config.decay
        else config.learning_rate
    )
    clip = optax.identity() if config.clip_norm is None else optax.clip_by_global_norm(config.clip_norm)
    return optax.chain(clip, optax.adam(rate))
