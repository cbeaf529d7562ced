"""Train the convolutional network, with progress, log and checkpoint between stretches."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Key, UInt8

from planspace.embed.losses import Terms
from planspace.embed.mlp import forward
from planspace.embed.pixels.config import STRIDE, ImageFitConfig
from planspace.embed.pixels.convolution import KERNEL, ConvolutionalNetwork, to_input
from planspace.embed.saved_embedding import LOG
from planspace.errors import PlanspaceError
from planspace.progress import progress
from planspace.storage.checkpoint import load_checkpoint, save_checkpoint
from planspace.storage.rows import append_rows

CHUNK = 100
"""Steps between two rows of the log and two checkpoints."""

State = TypeVar("State")

_he_normal = jax.nn.initializers.he_normal(in_axis=(0, 1, 2), out_axis=-1)
_lecun_normal = jax.nn.initializers.lecun_normal(in_axis=0, out_axis=-1)


class TrainedNetwork(eqx.Module):
    """The network of `embed.pixels.convolution` in JAX, where it can be trained."""

    kernels: list[tuple[Float[Array, "4 4 in out"], Float[Array, " out"]]]
    dense: list[tuple[Float[Array, "in out"], Float[Array, " out"]]]

    def __init__(self, config: ImageFitConfig, num_out: int, *, key: Key[Array, ""]):
        """Draw fresh weights."""
        view = config.pictures
        sizes = (view.stack_shape[-1], *config.channels)
        keys = jr.split(key, len(config.channels) + 2)
        pairs = zip(keys, sizes[:-1], sizes[1:], strict=False)
        self.kernels = [(_he_normal(k, (KERNEL, KERNEL, a, b)), jnp.zeros(b)) for k, a, b in pairs]
        shrunk = STRIDE ** len(config.channels)
        flat = (view.height // shrunk) * (view.width // shrunk) * sizes[-1]
        self.dense = [
            (_lecun_normal(keys[-2], (flat, config.hidden)), jnp.zeros(config.hidden)),
            (_lecun_normal(keys[-1], (config.hidden, num_out)), jnp.zeros(num_out)),
        ]

    def __call__(self, images: UInt8[Array, "batch height width channel"]) -> Float[Array, "batch out"]:
        """Compute the outputs of a batch, which XLA convolves much faster than single stacks."""
        x = to_input(images)
        for kernel, bias in self.kernels:
            layout = ("NHWC", "HWIO", "NHWC")
            x = jax.lax.conv_general_dilated(x, kernel, (STRIDE, STRIDE), "SAME", dimension_numbers=layout)
            x = jax.nn.relu(x + bias)
        return forward(self.dense, x.reshape(len(x), -1), jax.nn.relu)

    def to_numpy(self) -> ConvolutionalNetwork:
        """Return the network for inference."""
        kernels, dense = jax.tree.map(np.asarray, (self.kernels, self.dense))
        return ConvolutionalNetwork(tuple(kernels), tuple(dense))


class TrainState(eqx.Module):
    """Everything that changes during training."""

    network: TrainedNetwork
    optimiser: Any


def train_network(
    images: UInt8[np.ndarray, "stack height width channel"],
    targets: Float[np.ndarray, "stack out"],
    config: ImageFitConfig,
    seed: int,
    out: Path,
) -> ConvolutionalNetwork:
    """Minimise the mean squared error, or continue from the checkpoint in `out`.

    The randomness of a step depends only on the seed and its number, so that an interrupted training ends
    with the same weights.

    Args:
        images: the stacks.
        targets: what the network is to output for each, standardised.
        config: the settings.
        seed: seed of weights and batches.
        out: the run's folder, for checkpoint and log.

    Raises:
        PlanspaceError: the training diverged.
    """

    def step(state: TrainState, number: int) -> tuple[TrainState, Terms]:
        batch = np.random.default_rng((seed, number)).integers(len(images), size=config.batch)
        state, loss = _step(state, jnp.asarray(images[batch]), jnp.asarray(targets[batch]), config)
        return state, {"loss": loss}

    state = init(config, targets.shape[1], jr.key(seed))
    return run_steps(state, step, config.steps, out).network.to_numpy()


def run_steps(
    state: State, step: Callable[[State, int], tuple[State, Terms]], num_steps: int, out: Path
) -> State:
    """Take the steps of a training, or those that are missing after the checkpoint in `out`.

    Args:
        state: everything that changes, before the first step.
        step: takes one step, given the state and the number of the step; also returns terms for the log, with
            the `loss` among them.
        num_steps: how many steps.
        out: the run's folder, for checkpoint and log.

    Raises:
        PlanspaceError: the training diverged.
    """
    saved = load_checkpoint(out, state)
    state, first = (state, 0) if saved is None else (saved[0], saved[1]["step"])
    with progress("pixels", num_steps, done=first, unit="step") as bar:
        if first < num_steps:
            bar.set_postfix_str("compiling")
        while first < num_steps:
            length, found = min(CHUNK, num_steps - first), []
            for number in range(first, first + length):
                state, terms = step(state, number)
                found.append(terms)
            first += length
            names = dict.fromkeys(name for terms in found for name in terms)
            means = {n: float(np.mean([terms[n] for terms in found if n in terms])) for n in names}
            if not np.isfinite(means["loss"]):
                raise PlanspaceError(
                    f"training diverged before step {first}: try a lower --learning-rate, in another folder."
                )
            append_rows(out / LOG, [{"step": first, "time": time.time(), **means}], key="step")
            save_checkpoint(out, state, {"step": first})
            bar.update(length)
            bar.set_postfix_str(f"loss {means['loss']:.4g}", refresh=False)
    return state


@eqx.filter_jit
def init(config: ImageFitConfig, num_out: int, key: Key[Array, ""]) -> TrainState:
    """Draw fresh weights, in one compiled program."""
    network = TrainedNetwork(config, num_out, key=key)
    return TrainState(network, adam(config).init(eqx.filter(network, eqx.is_array)))


def adam(config: ImageFitConfig) -> optax.GradientTransformation:
    """Adam, with the learning rate scheduled as the settings say."""
    return optax.adam(optax.cosine_decay_schedule(config.learning_rate, config.steps))


@eqx.filter_jit
def _step(
    state: TrainState,
    images: UInt8[Array, "batch height width channel"],
    targets: Float[Array, "batch out"],
    config: ImageFitConfig,
) -> tuple[TrainState, Array]:
    def loss(network: TrainedNetwork) -> Array:
        return jnp.mean((network(images) - targets) ** 2)

    value, gradient = eqx.filter_value_and_grad(loss)(state.network)
    if config.target == "random":  # only the last layer moves
        zeros = jax.tree.map(jnp.zeros_like, gradient)
        gradient = eqx.tree_at(lambda g: g.dense[-1], zeros, gradient.dense[-1])
    updates, optimiser_state = adam(config).update(gradient, state.optimiser)
    return TrainState(eqx.apply_updates(state.network, updates), optimiser_state), value
