"""Training an embedding: several seeds at once, the best one chosen and saved."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import mujoco
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

import planspace
from planspace.checkpoint import load_checkpoint, save_checkpoint
from planspace.demos.dataset import Demos
from planspace.demos.triplets import PAPER_SPACINGS, triplet_rows
from planspace.embed.embedding import DESCRIPTION, Embedding, InputForm, Inputs, load_embedding
from planspace.embed.geometry import Geometry, measure, measure_raw_state
from planspace.embed.networks import GaussianNetwork, PlanSpaceModel
from planspace.embed.objectives import Terms, variational
from planspace.errors import PlanspaceError
from planspace.progress import progress
from planspace.store import append_row, open_run

CHUNK = 500
"""Optimiser steps compiled into one call; between calls come progress, log and checkpoint."""


@dataclass(frozen=True)
class FitConfig:
    """How an embedding is trained."""

    preset: Literal["modern", "paper"] = "modern"
    """Where the other fields' values come from."""
    z_dim: int = 3
    """Numbers in z; the paper has 3 and 10."""
    inputs: InputForm = "trig"
    """`raw` numbers, or sin and cos of circular angles and everything standardised."""
    spacings: tuple[int, ...] = PAPER_SPACINGS
    """Steps between the members of a triplet."""
    linearity: float = 2.0
    """lambda of equation 7: the weight of z_t lying at the midpoint; the paper has 0.5."""
    sigma_floor: float = 0.2
    """Least deviation of the decoder, in units of its inputs; without it the likelihood runs away."""
    steps: int = 12_000
    """Optimiser steps."""
    batch: int = 512
    """Triplets a step."""
    learning_rate: float = 2e-3
    """Adam's rate at first."""
    decay: bool = True
    """Whether the rate falls to zero by a cosine."""
    clip_norm: float | None = 10.0
    """Gradients are clipped to this norm."""


PRESETS: dict[str, FitConfig] = {
    "modern": FitConfig(),
    "paper": FitConfig(
        preset="paper",
        inputs="raw",
        linearity=0.5,
        sigma_floor=0.0,
        steps=200_000,  # the paper gives no length; the 2020 code took over 9 million
        batch=50,
        learning_rate=1e-3,
        decay=False,
        clip_norm=None,
    ),
}


class _State(eqx.Module):
    """Everything that changes during training, with a leading axis of seeds."""

    model: PlanSpaceModel
    optimiser: Any


def fit(
    demos: Demos, out: Path, *, config: FitConfig, num_seeds: int, seed: int, split_seed: int | None = None
) -> Embedding:
    """Trains seeds seed, seed + 1, ... at once, chooses one, and saves it in `out`.

    `modern` chooses by the midpoint error on the validation split among the seeds with no collapsed
    dimension; `paper` by the path error on the training split, as the paper does. The test split takes no
    part in either. The same call continues an interrupted one, and returns a finished one.

    Args:
        demos: the demonstrations.
        out: a folder of its own.
        config: how to train.
        num_seeds: how many seeds.
        seed: the first of them.
        split_seed: the seed of the split by demonstration; by default `seed`.

    Raises:
        PlanspaceError: the demonstrations do not do, the folder was made with other settings, or a seed
            diverged.
    """
    split_seed = seed if split_seed is None else split_seed
    seeds = list(range(seed, seed + num_seeds))
    settings = {"demos": demos.hash, "seeds": seeds, "split_seed": split_seed, "fit": asdict(config)}
    open_run(out, settings)
    if (out / DESCRIPTION).exists():
        return load_embedding(out)
    split = demos.split(split_seed)
    rows = triplet_rows(demos, split["train"], config.spacings)
    info = demos.info
    inputs = Inputs.fit(
        demos.states[demos.rows(split["train"])], info.names, info.units, info.circular_columns, config.inputs
    )
    data = jnp.asarray(inputs(demos.states), dtype=jnp.float32)
    state = _train(data, jnp.asarray(rows), config, seeds, out)
    embeddings = [_to_numpy(state.model, i, inputs, config) for i in range(num_seeds)]
    chosen, validation = _choose(embeddings, demos, split, config)
    about = {
        "preset": config.preset,
        "seed": seeds[chosen],
        "settings": settings,
        "split": {name: part.tolist() for name, part in split.items()},
        "metrics": {name: asdict(measure(embeddings[chosen], demos, part)) for name, part in split.items()},
        "metrics_raw_state": asdict(measure_raw_state(demos, split["test"], split["train"])),
        "metrics_of_seeds": {str(s): asdict(g) for s, g in zip(seeds, validation, strict=True)},
        "versions": {
            "planspace": planspace.__version__,
            "mujoco": mujoco.__version__,
            "jax": jax.__version__,
        },
    }
    embedding = replace(embeddings[chosen], about=about)
    embedding.save(out)
    return embedding


def _train(
    data: Float[Array, "row input"],
    rows: Int[Array, "triplet 3"],
    config: FitConfig,
    seeds: Sequence[int],
    out: Path,
) -> _State:
    keys = jnp.stack([jr.key(s) for s in seeds])
    state = _init(keys, data.shape[1], config)
    first = 0
    saved = load_checkpoint(out, state)
    if saved is not None:
        state, first = saved[0], saved[1]["step"]
    with progress("embed", config.steps, done=first, unit="step") as bar:
        while first < config.steps:
            length = min(CHUNK, config.steps - first)
            state, terms = _run_chunk(state, keys, data, rows, jnp.arange(first, first + length), config)
            means = {name: np.asarray(value).mean(axis=1) for name, value in vars(terms).items()}
            diverged = np.flatnonzero(~np.isfinite(means["bound"]))
            if len(diverged):
                raise PlanspaceError(
                    f"training diverged between steps {first} and {first + length} for seed "
                    f"{seeds[diverged[0]]}; {out} keeps the checkpoint before. Try a lower learning rate."
                )
            first += length
            save_checkpoint(out, state, {"step": first})
            append_row(
                out / "log.jsonl",
                {"step": first, "time": time.time(), **{k: v.tolist() for k, v in means.items()}},
            )
            bar.update(length)
            bar.set_postfix_str(f"bound {means['bound'].mean():.2f}", refresh=False)
    return state


def _make_optimiser(config: FitConfig) -> optax.GradientTransformation:
    rate = (
        optax.cosine_decay_schedule(config.learning_rate, config.steps)
        if config.decay
        else config.learning_rate
    )
    clip = optax.identity() if config.clip_norm is None else optax.clip_by_global_norm(config.clip_norm)
    return optax.chain(clip, optax.adam(rate))


@eqx.filter_jit
def _init(keys: Key[Array, " seed"], num_inputs: int, config: FitConfig) -> _State:
    def init_one(key: Key[Array, ""]) -> _State:
        model = PlanSpaceModel(num_inputs, config.z_dim, config.sigma_floor, key=key)
        return _State(model, _make_optimiser(config).init(eqx.filter(model, eqx.is_array)))

    return eqx.filter_vmap(init_one)(keys)


@eqx.filter_jit
def _run_chunk(
    state: _State,
    keys: Key[Array, " seed"],
    data: Float[Array, "row input"],
    rows: Int[Array, "triplet 3"],
    steps: Int[Array, " step"],
    config: FitConfig,
) -> tuple[_State, Terms]:
    """Some optimiser steps for all seeds; the randomness of a step depends on its seed and number alone."""
    optimiser = _make_optimiser(config)

    def loss(model: PlanSpaceModel, triplets: Array, key: Key[Array, ""]) -> tuple[Array, Terms]:
        keys = jr.split(key, len(triplets))
        terms = jax.vmap(lambda x, k: variational(model, x, config.linearity, key=k))(triplets, keys)
        mean = jax.tree.map(jnp.mean, terms)
        return -mean.bound, mean

    def one_step(state: _State, step: Array, seed_key: Key[Array, ""]) -> tuple[_State, Terms]:
        batch_key, noise_key = jr.split(jr.fold_in(seed_key, step))
        chosen = rows[jr.randint(batch_key, (config.batch,), 0, len(rows))]
        gradient, terms = eqx.filter_grad(loss, has_aux=True)(state.model, data[chosen], noise_key)
        updates, optimiser_state = optimiser.update(gradient, state.optimiser)
        return _State(eqx.apply_updates(state.model, updates), optimiser_state), terms

    def one_seed(state: _State, seed_key: Key[Array, ""]) -> tuple[_State, Terms]:
        return jax.lax.scan(lambda s, i: one_step(s, i, seed_key), state, steps)

    return eqx.filter_vmap(one_seed)(state, keys)


def _to_numpy(model: PlanSpaceModel, seed_index: int, inputs: Inputs, config: FitConfig) -> Embedding:
    def layers(network: GaussianNetwork) -> tuple[list[np.ndarray], list[np.ndarray]]:
        return (
            [np.asarray(w[seed_index]) for w in network.weights],
            [np.asarray(b[seed_index]) for b in network.biases],
        )

    return Embedding(inputs, layers(model.encode), layers(model.decode), config.sigma_floor)


def _choose(
    embeddings: list[Embedding], demos: Demos, split: dict[str, np.ndarray], config: FitConfig
) -> tuple[int, list[Geometry]]:
    """The seed to keep, and the validation metrics of all."""
    validation = [measure(e, demos, split["validation"]) for e in embeddings]
    if config.preset == "paper":
        train = [measure(e, demos, split["train"]) for e in embeddings]
        return int(np.argmin([g.path_error for g in train])), validation
    scores = [
        (g.active_dims < config.z_dim, g.midpoint_error) for g in validation
    ]  # a collapsed seed only if all are
    return min(range(len(scores)), key=lambda i: scores[i]), validation
