"""Training all seeds of an embedding at once, in compiled stretches; the only place with an axis of seeds."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from planspace.checkpoint import load_checkpoint, save_checkpoint
from planspace.embed.config import FitConfig
from planspace.embed.networks import PlanSpaceModel
from planspace.embed.objectives import OBJECTIVES, Terms
from planspace.embed.samples import Samples
from planspace.errors import PlanspaceError
from planspace.progress import progress

CHUNK = 500
"""Least number of steps compiled into one call; between calls come progress, log and checkpoint."""
MAX_CHUNKS = 400

Log = Callable[[int, int, PlanSpaceModel, dict[str, list[float]]], None]
"""Told after each stretch: steps done, steps done before it, the models, and the mean terms of each seed."""


class TrainState(eqx.Module):
    """Everything that changes during training, with a leading axis of seeds."""

    model: PlanSpaceModel
    optimiser: Any
    average: PlanSpaceModel | None
    """Running average of the model, where one is kept."""

    @property
    def kept(self) -> PlanSpaceModel:
        """The model that is measured and saved."""
        return self.model if self.average is None else self.average


def train(samples: Samples, config: FitConfig, seeds: Sequence[int], out: Path, log: Log) -> PlanSpaceModel:
    """Trains, or goes on from the checkpoint in `out`.

    Args:
        samples: what to draw from.
        config: how to train.
        seeds: each has random streams of its own, whatever seeds are trained beside it.
        out: the run's folder, for the checkpoint.
        log: where the curves go.

    Returns:
        The models, with a leading axis of seeds.

    Raises:
        PlanspaceError: a seed diverged; the checkpoint holds all seeds as they were before that step.
    """
    keys = jnp.stack([jr.key(s) for s in seeds])
    state = init(keys, samples, config)
    first = 0
    saved = load_checkpoint(out, state)
    if saved is not None:
        state, first = saved[0], saved[1]["step"]
    chunk = max(CHUNK, -(-config.steps // MAX_CHUNKS))
    with progress("embed", config.steps, done=first, unit="step") as bar:
        while first < config.steps:
            length = min(chunk, config.steps - first)
            before = state
            state, terms = run_steps(state, keys, samples, jnp.arange(first, first + length), config)
            if (bad := _first_bad(terms)) is not None:
                # the update before the bad step broke it: everything is kept as it was before that
                good, seed = first + max(bad.step - 1, 0), seeds[bad.seed]
                steps = jnp.arange(first, good)
                save_checkpoint(out, run_steps(before, keys, samples, steps, config)[0], {"step": good})
                raise PlanspaceError(
                    f"training diverged at step {first + bad.step} for seed {seed}; {out} keeps all seeds as "
                    f"they were before, at step {good}. Try a lower learning rate, or leave this seed out."
                )
            first += length
            save_checkpoint(out, state, {"step": first})
            means = {name: np.asarray(value).mean(axis=1).tolist() for name, value in terms.items()}
            log(first, first - length, state.kept, means)
            bar.update(length)
            bar.set_postfix_str(f"bound {np.mean(means['bound']):.2f}", refresh=False)
    return state.kept


@eqx.filter_jit
def init(keys: Key[Array, " seed"], samples: Samples, config: FitConfig) -> TrainState:
    """Fresh weights for each seed."""
    num_controls = samples.controls.shape[1]

    def init_one(key: Key[Array, ""]) -> TrainState:
        model = PlanSpaceModel(
            samples.inputs.shape[1],
            config.z_dim,
            config.hidden,
            config.sigma_floor,
            num_controls=num_controls,
            key=key,
        )
        optimiser = _make_optimiser(config).init(eqx.filter(model, eqx.is_array))
        return TrainState(model, optimiser, model if config.average else None)

    return eqx.filter_vmap(init_one)(keys)


@eqx.filter_jit
def run_steps(
    state: TrainState,
    keys: Key[Array, " seed"],
    samples: Samples,
    steps: Int[Array, " step"],
    config: FitConfig,
) -> tuple[TrainState, dict[str, Float[Array, "seed step"]]]:
    """Some optimiser steps for all seeds; the randomness of a step depends on its seed and number alone."""
    optimiser = _make_optimiser(config)
    objective = OBJECTIVES[config.objective.name]

    def loss(model: PlanSpaceModel, batch: Any, key: Key[Array, ""]) -> tuple[Array, Terms]:
        keys = jr.split(key, config.batch)
        terms = jax.vmap(lambda sample, k: objective(model, sample, config.objective, k))(batch, keys)
        means = jax.tree.map(jnp.mean, terms)
        return -means["bound"], means

    def one_step(state: TrainState, step: Array, seed_key: Key[Array, ""]) -> tuple[TrainState, Terms]:
        batch_key, noise_key = jr.split(jr.fold_in(seed_key, step))
        batch = samples.draw(batch_key, config.batch)
        gradient, terms = eqx.filter_grad(loss, has_aux=True)(state.model, batch, noise_key)
        updates, optimiser_state = optimiser.update(gradient, state.optimiser)
        model = eqx.apply_updates(state.model, updates)
        average = None
        if state.average is not None:
            average = jax.tree.map(
                lambda old, new: config.average * old + (1 - config.average) * new, state.average, model
            )
        return TrainState(model, optimiser_state, average), terms

    def one_seed(state: TrainState, seed_key: Key[Array, ""]) -> tuple[TrainState, Terms]:
        return jax.lax.scan(lambda s, i: one_step(s, i, seed_key), state, steps)

    return eqx.filter_vmap(one_seed)(state, keys)


class _Bad(NamedTuple):
    step: int
    seed: int


def _first_bad(terms: Terms) -> _Bad | None:
    """The first step of a stretch whose bound is not finite, and for which of the seeds."""
    finite = np.isfinite(np.asarray(terms["bound"]))
    if finite.all():
        return None
    step = int(np.argmin(finite.all(axis=0)))
    return _Bad(step, int(np.argmin(finite[:, step])))


def _make_optimiser(config: FitConfig) -> optax.GradientTransformation:
    rate = (
        optax.cosine_decay_schedule(config.learning_rate, config.steps)
        if config.decay
        else config.learning_rate
    )
    clip = optax.identity() if config.clip_norm is None else optax.clip_by_global_norm(config.clip_norm)
    return optax.chain(clip, optax.adam(rate))
