"""Train an encoder of pictures: draw stacks, train a network on them, measure it, save it."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.pixels.alone import Lesson, learn_alone, prepare
from planspace.embed.pixels.appearance import Appearance
from planspace.embed.pixels.card import image_card
from planspace.embed.pixels.config import ImageFitConfig
from planspace.embed.pixels.convolution import ConvolutionalNetwork
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.embed.pixels.measure import measure_images
from planspace.embed.pixels.saved import DESCRIPTION, load_image_encoder
from planspace.embed.pixels.stacks import (
    Stacks,
    check_pictures,
    default_frame_s,
    draw_stacks,
    stacks_of_plans,
)
from planspace.embed.pixels.training import train_network
from planspace.embed.saved_embedding import CARD
from planspace.errors import UsageError
from planspace.physics.angles import wrap
from planspace.progress import progress_shown
from planspace.seams import plain_settings
from planspace.storage.files import write_bytes
from planspace.storage.provenance import Provenance
from planspace.storage.runs import lock_folder, open_run

LEAST_STD = 1e-6
NUM_HELD_OUT = 512
"""Stacks on which the error of the estimated state is measured."""
HELD_OUT_STREAM = 1
"""Number of the random stream of these stacks."""


def fit_image_encoder(
    demos: Demos,
    teacher: Embedding | None = None,
    *,
    config: ImageFitConfig | None = None,
    visited: Sequence[Demos] = (),
    out: str | Path | None = None,
    seed: int = 0,
    verbose: bool = True,
) -> ImageEncoder:
    """Train a network to compute z from pictures.

    With a teacher, the network learns to compute z as the teacher computes it from states: the training sees
    the states of the pictures (privileged information); the encoder does not. Without a teacher, and with the
    target `pictures`, an objective is minimised on the pictures alone; an embedding of states is fitted to
    the result afterwards.

    Args:
        demos: the demonstrations, with a model.
        teacher: the embedding of their states; none for the target `pictures`.
        config: the settings.
        visited: datasets of states that a policy or a controller visited (DAgger: act, add what was visited,
            train again). Plans, search trees if they were kept, and each of these datasets give equally many
            training states.
        out: a folder for the encoder. The same call continues an interrupted training, and returns a finished
            one. By default nothing is saved.
        seed: seed of stacks, weights and batches.
        verbose: show progress bars.

    Raises:
        UsageError: teacher, demonstrations and settings do not fit together.
        PlanspaceError: there is no model, nothing can be drawn here, the folder was made with other settings,
            or the training diverged.
    """
    request = _Request(demos, teacher, config or ImageFitConfig(), tuple(visited), seed)
    with progress_shown(verbose):
        if out is not None:
            return _fit(request, Path(out))
        with tempfile.TemporaryDirectory() as folder:
            return _fit(request, Path(folder) / "encoder")


@dataclass(frozen=True)
class _Request:
    demos: Demos
    teacher: Embedding | None
    config: ImageFitConfig
    visited: tuple[Demos, ...]
    seed: int

    def __post_init__(self) -> None:
        """Check that there is a teacher if the target needs one."""
        target = self.config.target
        if self.teacher is None and target != "pictures":
            raise UsageError(f"the target {target!r} needs a teacher: the embedding of states to learn from.")
        if self.teacher is not None and target == "pictures":
            raise UsageError("the target 'pictures' learns a z of its own: leave out the teacher.")

    @property
    def split(self) -> dict[str, np.ndarray]:
        """The teacher's split if these are its demonstrations, so that its test plans stay unseen."""
        about = None if self.teacher is None else self.teacher.about
        if about is not None and about.settings.demos == self.demos.hash:
            return {name: np.array(part) for name, part in about.split.items()}
        return self.demos.split(self.seed)

    @property
    def frame_s(self) -> float:
        """Time between two frames [s]."""
        return self.config.frame_s or default_frame_s(self.demos)


def _fit(request: _Request, out: Path) -> ImageEncoder:
    names = request.demos.info.names
    if request.teacher is not None:
        request.teacher.columns_of(names, request.demos.info.units)
    for other in request.visited:
        if other.info.names != names:
            raise UsageError(
                f"the visited states must be those of the demonstrations ({', '.join(names)}), got "
                f"{', '.join(other.info.names)}."
            )
    settings: dict[str, Any] = {
        "demos": request.demos.hash,
        "teacher": None if request.teacher is None else request.teacher.hash,
        "visited": [other.hash for other in request.visited],
        "seed": request.seed,
        "frame_s": request.frame_s,
        "fit": plain_settings(request.config),
    }
    if request.teacher is None:
        settings["fit"]["space"] = plain_settings(request.config.space)
    lesson = None
    if not (out / DESCRIPTION).exists():  # otherwise nothing is drawn
        check_pictures(request.demos, request.config.pictures, request.frame_s)
        if request.teacher is None:
            lesson = prepare(request.demos, request.split, request.config, request.frame_s, request.seed)
    with lock_folder(out):
        open_run(out, settings)
        if (out / DESCRIPTION).exists():
            return load_image_encoder(out)
        encoder = _distil(request, out) if lesson is None else _learn(request, lesson, out)
        return _measure_and_save(request, encoder, settings, out)


def _measure_and_save(
    request: _Request, encoder: ImageEncoder, settings: dict[str, Any], out: Path
) -> ImageEncoder:
    found = measure_images(encoder, request.demos, request.split["test"])
    about = {
        "problem": request.demos.info.problem or "",
        "settings": settings,
        "metrics": found.summary(),
        "versions": Provenance.current("mujoco", "jax").plain(),
    }
    encoder = replace(encoder, about=about, state_error=_state_error(request, encoder))
    write_bytes(out / CARD, image_card(encoder).encode())
    encoder.save(out)
    return encoder


def _distil(request: _Request, out: Path) -> ImageEncoder:
    """Train the network on what the teacher says of the states."""
    teacher, config = request.teacher, request.config
    assert teacher is not None
    stacks = draw_stacks(_sources(request, "train"), config, request.frame_s, request.seed)
    states = stacks.states[:, list(teacher.columns_of(request.demos.info.names))]
    targets = teacher.inputs(states) if config.target == "state" else teacher.encode(states)
    mean, std = targets.mean(axis=0), np.maximum(targets.std(axis=0), LEAST_STD)
    scaled = ((targets - mean) / std).astype(np.float32)
    network = train_network(stacks.images, scaled, config, request.seed, out)
    return _encoder(request, network, teacher, stacks, mean.astype(np.float64), std.astype(np.float64))


def _learn(request: _Request, lesson: Lesson, out: Path) -> ImageEncoder:
    """Train the network on pictures of plans alone."""
    config, frame_s, seed = request.config, request.frame_s, request.seed
    _, on_plans = stacks_of_plans(request.demos, request.split["train"], config.pictures, frame_s)
    off_plans = draw_stacks(_sources(request, "train"), config, frame_s, seed)
    network, embedding = learn_alone(lesson, on_plans, off_plans, config, seed, out)
    z_dim = config.space.z_dim
    return _encoder(request, network, embedding, off_plans, np.zeros(z_dim), np.ones(z_dim))


def _encoder(
    request: _Request,
    network: ConvolutionalNetwork,
    embedding: Embedding,
    stacks: Stacks,
    mean: np.ndarray,
    std: np.ndarray,
) -> ImageEncoder:
    return ImageEncoder(
        network=network,
        mean=mean,
        std=std,
        target=request.config.target,
        teacher=embedding,
        pictures=request.config.pictures,
        frame_s=request.frame_s,
        appearance=Appearance.fit(stacks.images[..., -3:]),
    )


def _sources(request: _Request, part: str) -> list[tuple[Demos, np.ndarray]]:
    """The states that stacks start from: of plans, of search trees if they were kept, and visited ones."""
    demos, plans = request.demos, request.split[part]
    sources = [(demos, demos.states[demos.rows(plans)])]
    if demos.trees:
        sources.append((demos, np.concatenate([demos.trees[int(i)].states for i in plans])))
    return sources + [(other, other.states) for other in request.visited]


def _state_error(request: _Request, encoder: ImageEncoder) -> Float[np.ndarray, " state"]:
    """Root-mean-square error of the estimated state on stacks of held-out plans and of visited states."""
    names, inputs = request.demos.info.names, encoder.teacher.inputs
    config = replace(request.config, stacks=NUM_HELD_OUT)
    stacks = draw_stacks(_sources(request, "test"), config, request.frame_s, request.seed, HELD_OUT_STREAM)
    true = stacks.states[:, list(encoder.teacher.columns_of(names))]
    error = encoder.states(stacks.images) - true
    circular = list(inputs.circular_columns)
    error[:, circular] = wrap(error[:, circular])
    return np.maximum(np.sqrt((error**2).mean(axis=0)), LEAST_STD)
