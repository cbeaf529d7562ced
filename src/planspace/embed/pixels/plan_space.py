"""Learn a plan space from pictures alone: an objective of states, minimised on triplets of stacks."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Key, UInt8

from planspace.embed import losses
from planspace.embed.config import PAPER_HIDDEN
from planspace.embed.gaussian import DiagonalGaussian
from planspace.embed.losses import Terms
from planspace.embed.mlp import forward
from planspace.embed.networks import Transition, glorot_layers, positive
from planspace.embed.objective import split_loss
from planspace.embed.objectives.vae import AutoEncoder
from planspace.embed.pixels.appearance import in_blocks
from planspace.embed.pixels.config import ImageFitConfig
from planspace.embed.pixels.convolution import to_input
from planspace.embed.pixels.training import TrainedNetwork, adam, run_steps
from planspace.embed.samples import Sample, Samples
from planspace.embed.tracing import uses_decoder

SIGMA_FLOOR = 0.2
"""Smallest standard deviation of a drawn number, as for the states that `FitConfig` decodes."""
CLIP_NORM = 10.0
"""Norm to which gradients are clipped."""


class Shrinking(eqx.Module):
    """What the decoder draws of a stack: the newest picture, and its change since the oldest one.

    Both are means over blocks of pixels, and standardised, so that velocities count like positions.
    """

    mean: Float[Array, "height width 3"]
    newest: Float[Array, ""]
    """Standard deviation of the newest picture around the mean."""
    change: Float[Array, ""]
    """Standard deviation of the change."""

    @classmethod
    def fit(cls, stacks: UInt8[np.ndarray, "stack height width channel"]) -> "Shrinking":
        """Compute the mean and the scales of training stacks."""
        blocks = np.concatenate([_blocks(part) for part in np.array_split(stacks, -(-len(stacks) // 256))])
        newest, change = blocks[..., -3:], blocks[..., -3:] - blocks[..., :3]
        mean = newest.mean(axis=0)
        scales = ((newest - mean).std(), change.std())
        return cls(jnp.asarray(mean), *(jnp.asarray(s if s > 0 else 1.0, jnp.float32) for s in scales))

    def __call__(self, stack: UInt8[Array, "height width channel"]) -> Float[Array, " number"]:
        """Compute the numbers of one stack."""
        blocks = _blocks(stack)
        fixed = jax.lax.stop_gradient(self)
        newest = (blocks[..., -3:] - fixed.mean) / fixed.newest
        if stack.shape[-1] == 3:  # one frame
            return newest.reshape(-1)
        return jnp.stack([newest, (blocks[..., -3:] - blocks[..., :3]) / fixed.change]).reshape(-1)


class DrawnPictures(eqx.Module):
    """The distribution p(x|z) of a stack x."""

    mu: Float[Array, " number"]
    sigma: Float[Array, ""]
    shrink: Shrinking
    weight: float = eqx.field(static=True)

    def log_prob(self, stack: UInt8[Array, "height width channel"]) -> Float[Array, ""]:
        """The mean log likelihood of what is drawn of a stack, times the weight."""
        error = (self.shrink(stack) - self.mu) / self.sigma
        return -self.weight * jnp.mean(0.5 * error**2 + jnp.log(self.sigma))


class PictureDecoder(eqx.Module):
    """p(x|z): two hidden layers, and one standard deviation that is learned."""

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    log_sigma: Float[Array, ""]
    shrink: Shrinking
    weight: float = eqx.field(static=True)

    def __call__(self, z: Float[Array, " z"]) -> DrawnPictures:
        """Compute the distribution for one z."""
        layers = [(weight.T, bias) for weight, bias in zip(self.weights, self.biases, strict=True)]
        mu = forward(layers, z, jax.nn.relu)
        return DrawnPictures(mu, SIGMA_FLOOR + jnp.exp(self.log_sigma), self.shrink, self.weight)


class PictureEncoder(eqx.Module):
    """q(z|x): the convolutional network, whose outputs are means and standard deviations."""

    network: TrainedNetwork

    def __call__(self, stack: UInt8[Array, "height width channel"]) -> DiagonalGaussian:
        """Compute the Gaussian for one stack."""
        mu, rho = jnp.split(self.network(stack[None])[0], 2)
        return DiagonalGaussian(mu, positive(rho))


class PictureModel(eqx.Module):
    """What an `Objective` sees as the model: as `PlanSpaceModel`, with stacks of pictures as inputs."""

    encode: PictureEncoder
    decode: PictureDecoder
    log_scale: Float[Array, ""]
    transition: Transition | None

    @property
    def scale(self) -> Float[Array, ""]:
        """The length in z of one mean duration of a demonstration."""
        return jnp.exp(self.log_scale)


class TrainState(eqx.Module):
    """Everything that changes during training."""

    model: PictureModel
    optimiser: Any


@dataclass(frozen=True)
class PictureTriplets:
    """The training data: stacks of plans with their triplets, and stacks off the plans."""

    images: UInt8[np.ndarray, "row height width channel"]
    samples: Samples
    """Triplets of the rows, with times and controls; its inputs of states are not used."""
    off_plans: UInt8[np.ndarray, "stack height width channel"]

    STACKS: ClassVar[int] = 4
    """Stacks that a sample contains."""

    def draw(self, rng: np.random.Generator, num: int) -> Sample:
        """Draw a batch of triplets of stacks."""
        chosen = rng.integers(len(self.samples.triplets), size=num)
        rows = np.asarray(self.samples.triplets)[chosen]
        return Sample(
            jnp.asarray(self.images[rows]),
            self.samples.w[chosen],
            self.samples.duration[chosen],
            jnp.asarray(self.off_plans[rng.integers(len(self.off_plans), size=num)]),
            self.samples.controls[rows[:, 0]],
        )


@dataclass(frozen=True)
class LearnedSpace:
    """A trained encoder q(z|x) of pictures."""

    network: TrainedNetwork

    def read(
        self, stacks: UInt8[np.ndarray, "stack height width channel"]
    ) -> tuple[Float[np.ndarray, "stack z"], Float[np.ndarray, "stack z"]]:
        """Means and standard deviations of z."""
        parts = np.array_split(stacks, -(-len(stacks) // 256))
        mu, sigma = zip(*(_read(self.network, jnp.asarray(part)) for part in parts), strict=True)
        return np.concatenate(mu), np.concatenate(sigma)


def learn_plan_space(data: PictureTriplets, config: ImageFitConfig, seed: int, out: Path) -> LearnedSpace:
    """Minimise the objective, or continue from the checkpoint in `out`.

    No state of a plan is used. The loss begins as that of an auto-encoder, see `warm_up`.

    Args:
        data: stacks and triplets.
        config: the settings.
        seed: seed of weights and batches.
        out: the run's folder, for checkpoint and log.

    Raises:
        PlanspaceError: the training diverged.
    """
    space = config.space
    key, step_key = jr.split(jr.key(seed))
    model = _new_model(data, config, key)
    num = max(1, config.batch // data.STACKS)
    state = TrainState(model, _optimiser(config).init(eqx.filter(model, eqx.is_inexact_array)))

    def step(state: TrainState, number: int) -> tuple[TrainState, Terms]:
        rng, keys = np.random.default_rng((seed, number)), jr.split(jr.fold_in(step_key, number), num)
        warm = max(0.0, 1 - number / (space.warm_up * config.steps)) if space.warm_up else 0.0
        return _step(state, data.draw(rng, num), keys, jnp.asarray(warm), config, warming_up=warm > 0)

    return LearnedSpace(run_steps(state, step, config.steps, out).model.encode.network)


def check_objective(samples: Samples, config: ImageFitConfig) -> None:
    """Trace the objective's loss on a black triplet, without compiling it.

    Args:
        samples: the triplets that it will be minimised on.
        config: the settings.

    Raises:
        UsageError: the loss raises an exception, because it calculates with states, or does not return what
            `Objective.loss` requires.
    """
    black = np.zeros((1, *config.pictures.stack_shape), dtype=np.uint8)
    data = PictureTriplets(np.broadcast_to(black, (len(samples.inputs), *black.shape[1:])), samples, black)
    model = _new_model(replace(data, images=black), config, jr.key(0))
    sample = jax.tree.map(lambda a: a[0], data.draw(np.random.default_rng(0), 1))
    uses_decoder(config.space.objective, model, sample, jr.key(0))


def _new_model(data: PictureTriplets, config: ImageFitConfig, key: Key[Array, ""]) -> PictureModel:
    space = config.space
    network_key, decoder_key, transition_key = jr.split(key, 3)
    shrink, num_controls = Shrinking.fit(data.images), data.samples.controls.shape[1]
    num_drawn = shrink(jnp.asarray(data.images[0])).size
    sizes = (space.z_dim, config.hidden, config.hidden, num_drawn)
    transition = None
    if num_controls:
        transition = Transition(space.z_dim, num_controls, PAPER_HIDDEN, key=transition_key)
    return PictureModel(
        encode=PictureEncoder(TrainedNetwork(config, 2 * space.z_dim, key=network_key)),
        decode=PictureDecoder(
            *glorot_layers(sizes, decoder_key), jnp.zeros(()), shrink, float(space.picture_weight)
        ),
        log_scale=jnp.zeros(()),
        transition=transition,
    )


@eqx.filter_jit
def _step(
    state: TrainState,
    batch: Sample,
    keys: Key[Array, " triplet"],
    warm: Float[Array, ""],
    config: ImageFitConfig,
    *,
    warming_up: bool,
) -> tuple[TrainState, Terms]:
    """Take one step. It is compiled twice, because XLA convolves slowly inside a condition."""

    def loss_of(trained: PictureModel) -> tuple[Array, Terms]:
        model: Any = trained  # it has what an objective needs of a `PlanSpaceModel`

        def one(sample: Sample, key: Key[Array, ""]) -> tuple[Array, Terms]:
            loss, terms = split_loss(config.space.objective.loss(model, sample, key=key))
            if warming_up:  # one of the three stacks says what all three would
                log_likelihood, prior_kl = losses.autoencode(model, sample.x[1], key=key)
                loss = (1 - warm) * loss - warm * 3 * (log_likelihood - AutoEncoder().prior * prior_kl)
            return jnp.asarray(loss), {name: jnp.asarray(term) for name, term in terms.items()}

        return jax.tree.map(jnp.mean, jax.vmap(one)(batch, keys))

    (loss, terms), gradient = eqx.filter_value_and_grad(loss_of, has_aux=True)(state.model)
    updates, optimiser = _optimiser(config).update(gradient, state.optimiser)
    return TrainState(eqx.apply_updates(state.model, updates), optimiser), {"loss": loss, **terms}


def _optimiser(config: ImageFitConfig) -> optax.GradientTransformation:
    return optax.chain(optax.clip_by_global_norm(CLIP_NORM), adam(config))


@eqx.filter_jit
def _read(network: TrainedNetwork, stacks: UInt8[Array, "stack height width channel"]) -> tuple[Array, Array]:
    mu, rho = jnp.split(network(stacks), 2, axis=1)
    return mu, positive(rho)


def _blocks(stacks: Any) -> Any:
    """Means over blocks of pixels of one stack or of many, in NumPy or JAX."""
    return in_blocks(to_input(stacks)).mean(axis=(-4, -2))
