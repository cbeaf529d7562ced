"""Learn from pictures alone: triplets of plans, a plan space of their pictures, and its twin for states."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.resample import resample
from planspace.embed.config import FitConfig
from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.embed.objective import title_of
from planspace.embed.pixels.config import ImageFitConfig
from planspace.embed.pixels.convolution import ConvolutionalNetwork, with_linear_map
from planspace.embed.pixels.plan_space import PictureTriplets, check_objective, learn_plan_space
from planspace.embed.pixels.stacks import Stacks
from planspace.embed.pixels.twin import fit_twin
from planspace.embed.principal import principal_map
from planspace.embed.rotations import find_quaternions
from planspace.embed.samples import Samples, make_samples
from planspace.embed.support import Support
from planspace.errors import UsageError

STANDARD = FitConfig()
"""Scale and whitening of z are those of embeddings of states."""


@dataclass(frozen=True)
class Lesson:
    """What is known of the training plans before anything is drawn."""

    samples: Samples
    """Triplets of frames, with times and controls."""
    inputs: Inputs
    """What the embedding of states will see of a state."""
    train: Float[np.ndarray, "row state"]
    """The states of the frames, which training on pictures does not use."""
    validation: Float[np.ndarray, "other_row state"]


def prepare(
    demos: Demos,
    split: dict[str, Int[np.ndarray, " demo"]],
    config: ImageFitConfig,
    frame_s: float,
    seed: int,
) -> Lesson:
    """Draw triplets of frames, and check that the objective can be minimised on pictures.

    Args:
        demos: the plans.
        split: which of them are for training and validation.
        config: the settings.
        frame_s: time between two frames [s].
        seed: seed of the triplets.

    Raises:
        UsageError: the objective calculates with states.
        PlanspaceError: the plans are too short, or have no controls and the objective needs them.
    """
    info, space = demos.info, config.space
    plans = Demos.from_episodes(
        info, [resample(demos.episode(int(i)), info, frame_s) for i in split["train"]]
    )
    quaternions = find_quaternions(info, info.names, "trig")
    inputs = Inputs.fit(plans.states, info.names, info.units, info.circular_columns, "trig", quaternions)
    if space.objective.closed_form(inputs, plans.states, space.z_dim) is not None:
        raise UsageError(
            f"the objective {title_of(space.objective)} is computed from states: choose another for pictures."
        )
    samples = make_samples(plans, np.arange(len(plans)), inputs, FitConfig(objective=space.objective), seed)
    check_objective(samples, config)
    return Lesson(samples, inputs, plans.states, demos.states[demos.rows(split["validation"])])


def learn_alone(
    lesson: Lesson, on_plans: Stacks, off_plans: Stacks, config: ImageFitConfig, seed: int, out: Path
) -> tuple[ConvolutionalNetwork, Embedding]:
    """Train the network on pictures, then fit an embedding of states to its z.

    Args:
        lesson: the triplets.
        on_plans: the stacks of the frames.
        off_plans: stacks of other motions.
        config: the settings.
        seed: seed of weights and batches.
        out: the run's folder, for checkpoint and log.

    Returns:
        The network, and the embedding of states with the same z.

    Raises:
        PlanspaceError: the training diverged.
    """
    data = PictureTriplets(on_plans.images, lesson.samples, off_plans.images)
    learned = learn_plan_space(data, config, seed, out)
    z = [learned.read(stacks.images) for stacks in (on_plans, off_plans)]
    mu, sigma = (np.concatenate(parts) for parts in zip(*z, strict=True))
    states = np.concatenate([on_plans.states, off_plans.states])
    twin = fit_twin(lesson.inputs, states, mu, sigma, config.steps, seed)
    to_z = principal_map(twin, lesson.train, whitening=STANDARD.whitening, std=STANDARD.z_std)
    support = Support.fit(
        lesson.inputs(lesson.train),
        lesson.inputs(lesson.validation),
        np.random.default_rng(np.random.SeedSequence([seed, 2])),
    )
    twin = replace(twin, linear_map=to_z, support=support)
    return with_linear_map(learned.network.to_numpy(), to_z), twin
