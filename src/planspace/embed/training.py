"""Training all seeds of an embedding at once, in compiled stretches; the only place with an axis of seeds."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Int, Key

from planspace.embed.config import FitConfig
from planspace.embed.networks import PlanSpaceModel
from planspace.embed.objectives import OBJECTIVES, Terms
from planspace.embed.samples import Samples
from planspace.errors import PlanspaceError, UsageError
from planspace.progress import progress
from planspace.storage.checkpoint import load_checkpoint, save_checkpoint
from planspace.workers import count_cores

CHUNK = 100
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
    init_keys, keys = jnp.stack([jr.split(jr.key(s)) for s in seeds]).T
    saved = load_checkpoint(out, eqx.filter_eval_shape(init, init_keys, samples, config))
    if saved is None:
        state, first = init(init_keys, samples, config), 0
    else:
        state, first = saved[0], saved[1]["step"]
    chunk = max(CHUNK, -(-config.steps // MAX_CHUNKS))

    advance = make_advance(keys, samples, config, chunk)
    with progress("embed", config.steps, done=first, unit="step") as bar:
        while first < config.steps:
            length = min(chunk, config.steps - first)
            after, terms = advance(state, first, length)
            _, next_terms = advance(after, first + length, 1)  # is `after` still sound?
            bounds = np.concatenate([terms["bound"][:, :length], next_terms["bound"][:, :1]], axis=1)
            if not np.isfinite(bounds).all():
                # a step's bound is taken before its update: the update before the first bad bound broke it
                bad = int(np.argmin(np.isfinite(bounds).all(axis=0)))
                good = max(bad - 1, 0)
                save_checkpoint(out, advance(state, first, good)[0], {"step": first + good})
                seed = seeds[int(np.argmin(np.isfinite(bounds[:, bad])))]
                raise _divergence(first + bad, first + good, seed, out)
            state = after
            first += length
            means = {name: np.asarray(v)[:, :length].mean(axis=1).tolist() for name, v in terms.items()}
            log(first, first - length, state.kept, means)  # first, so that none is missing
            save_checkpoint(out, state, {"step": first})
            bar.update(length)
            bar.set_postfix_str(f"bound {np.mean(means['bound']):.2f}", refresh=False)
    return state.kept


def use_device(platform: str) -> None:
    """Has JAX compute on the first device of a platform from now on.

    Args:
        platform: cpu, gpu, cuda, tpu; whatever the JAX that is installed knows.

    Raises:
        UsageError: there is no such device.
    """
    try:
        jax.config.update("jax_default_device", jax.devices(platform)[0])
    except RuntimeError as error:
        have = ", ".join(sorted({"cpu", jax.default_backend()}))
        raise UsageError(f"no device {platform!r} for the JAX that is installed; it has {have}.") from error


def seed_groups(num_seeds: int) -> list[slice]:
    """The seeds that are stepped together: two or three on a CPU, elsewhere all.

    XLA makes little use of a second core on networks this small; threads with a group each do. The groups are
    the same whatever the number of cores, for rounding may depend on a group's size.
    """
    device = jax.config.jax_default_device or jax.devices()[0]
    count = -(-num_seeds // 3) if device.platform == "cpu" else 1
    edges = [round(i * num_seeds / count) for i in range(count + 1)]
    return [slice(a, b) for a, b in pairwise(edges)]


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


def make_advance(
    keys: Key[Array, " seed"], samples: Samples, config: FitConfig, chunk: int
) -> Callable[[TrainState, int, int], tuple[TrainState, Terms]]:
    """`run_steps` for any number of seeds: the groups shared out among threads."""
    groups = seed_groups(len(keys))
    pool = ThreadPoolExecutor(min(len(groups), count_cores()))

    def advance(state: TrainState, first: int, count: int) -> tuple[TrainState, Terms]:
        def advance_group(group: slice) -> Any:
            part = jax.tree.map(lambda a: np.asarray(a)[group], state)
            # arrays, for a Python number would be compiled in
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
    """Optimiser steps first .. first + count - 1 for all seeds, count at most `chunk`; compiled once for all.

    The randomness of a step depends on its seed and number alone.

    Returns:
        The state after them, and each term [seed, chunk], of which the first `count` are meant.
    """
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
        def body(i: Array, carry: tuple[TrainState, Terms]) -> tuple[TrainState, Terms]:
            state, history = carry
            state, terms = one_step(state, first + i, seed_key)
            return state, jax.tree.map(lambda past, now: past.at[i].set(now), history, terms)

        _, shapes = eqx.filter_eval_shape(one_step, state, first, seed_key)
        history = {name: jnp.full(chunk, jnp.nan, shape.dtype) for name, shape in shapes.items()}
        return jax.lax.fori_loop(0, count, body, (state, history))

    return eqx.filter_vmap(one_seed)(state, keys)


def _divergence(bad: int, good: int, seed: int, out: Path) -> PlanspaceError:
    if bad == 0:
        return PlanspaceError(
            f"the objective is not finite for seed {seed} before the first step; look at the demonstrations' "
            "times and numbers (planspace demos show)."
        )
    return PlanspaceError(
        f"training diverged at step {bad} for seed {seed}; {out} keeps all seeds as they were before, at "
        f"step {good}. Try a lower --learning-rate or other seeds, in another folder."
    )


def _make_optimiser(config: FitConfig) -> optax.GradientTransformation:
    rate = (
        optax.cosine_decay_schedule(config.learning_rate, config.steps)
        if config.decay
        else config.learning_rate
    )
    clip = optax.identity() if config.clip_norm is None else optax.clip_by_global_norm(config.clip_norm)
    return optax.chain(clip, optax.adam(rate))
