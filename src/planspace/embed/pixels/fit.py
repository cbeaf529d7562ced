"""Train an encoder of pictures: draw stacks, distil the teacher into a network, measure it, save it."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.pixels.appearance import Appearance
from planspace.embed.pixels.card import image_card
from planspace.embed.pixels.config import ImageFitConfig
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.embed.pixels.measure import measure_images
from planspace.embed.pixels.saved import DESCRIPTION, load_image_encoder
from planspace.embed.pixels.stacks import Stacks, check_pictures, default_frame_s, draw_stacks
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
    teacher: Embedding,
    *,
    config: ImageFitConfig | None = None,
    visited: Sequence[Demos] = (),
    out: str | Path | None = None,
    seed: int = 0,
    verbose: bool = True,
) -> ImageEncoder:
    """Train a network to compute z from pictures as the teacher computes it from states.

    The training sees the states of the pictures (privileged information); the encoder does not.

    Args:
        demos: the demonstrations, with a model.
        teacher: the embedding of their states.
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
    teacher: Embedding
    config: ImageFitConfig
    visited: tuple[Demos, ...]
    seed: int

    @property
    def split(self) -> dict[str, np.ndarray]:
        """The teacher's split if these are its demonstrations, so that its test plans stay unseen."""
        about = self.teacher.about
        if about is not None and about.settings.demos == self.demos.hash:
            return {name: np.array(part) for name, part in about.split.items()}
        return self.demos.split(self.seed)

    @property
    def frame_s(self) -> float:
        """Time between two frames [s]."""
        return self.config.frame_s or default_frame_s(self.demos)


def _fit(request: _Request, out: Path) -> ImageEncoder:
    names = request.demos.info.names
    request.teacher.columns_of(names)
    for other in request.visited:
        if other.info.names != names:
            raise UsageError(
                f"the visited states must be those of the demonstrations ({', '.join(names)}), got "
                f"{', '.join(other.info.names)}."
            )
    settings: dict[str, Any] = {
        "demos": request.demos.hash,
        "teacher": request.teacher.hash,
        "visited": [other.hash for other in request.visited],
        "seed": request.seed,
        "frame_s": request.frame_s,
        "fit": plain_settings(request.config),
    }
    if not (out / DESCRIPTION).exists():  # otherwise nothing is drawn
        check_pictures(request.demos, request.config.pictures, request.frame_s)
    with lock_folder(out):
        open_run(out, settings)
        if (out / DESCRIPTION).exists():
            return load_image_encoder(out)
        return _train_and_save(request, settings, out)


def _train_and_save(request: _Request, settings: dict[str, Any], out: Path) -> ImageEncoder:
    demos, teacher, config = request.demos, request.teacher, request.config
    split = request.split
    stacks = draw_stacks(_sources(request, "train"), config, request.frame_s, request.seed)
    targets = _targets(request, stacks)
    mean, std = targets.mean(axis=0), np.maximum(targets.std(axis=0), LEAST_STD)
    scaled = ((targets - mean) / std).astype(np.float32)
    encoder = ImageEncoder(
        network=train_network(stacks.images, scaled, config, request.seed, out),
        mean=mean.astype(np.float64),
        std=std.astype(np.float64),
        target=config.target,
        teacher=teacher,
        pictures=config.pictures,
        frame_s=request.frame_s,
        appearance=Appearance.fit(stacks.images[..., -3:]),
    )
    found = measure_images(encoder, demos, split["test"])
    about = {
        "problem": demos.info.problem or "",
        "settings": settings,
        "metrics": found.summary(),
        "versions": Provenance.current("mujoco", "jax").plain(),
    }
    encoder = replace(encoder, about=about, state_error=_state_error(request, encoder))
    write_bytes(out / CARD, image_card(encoder).encode())
    encoder.save(out)
    return encoder


def _sources(request: _Request, part: str) -> list[tuple[Demos, np.ndarray]]:
    """The states that stacks start from: of plans, of search trees if they were kept, and visited ones."""
    demos, plans = request.demos, request.split[part]
    sources = [(demos, demos.states[demos.rows(plans)])]
    if demos.trees:
        sources.append((demos, np.concatenate([demos.trees[int(i)].states for i in plans])))
    return sources + [(other, other.states) for other in request.visited]


def _state_error(request: _Request, encoder: ImageEncoder) -> Float[np.ndarray, " state"]:
    """Root-mean-square error of the estimated state on stacks of held-out plans and of visited states."""
    names, inputs = request.demos.info.names, request.teacher.inputs
    config = replace(request.config, stacks=NUM_HELD_OUT)
    stacks = draw_stacks(_sources(request, "test"), config, request.frame_s, request.seed, HELD_OUT_STREAM)
    true = stacks.states[:, list(request.teacher.columns_of(names))]
    error = encoder.states(stacks.images) - true
    circular = list(inputs.circular_columns)
    error[:, circular] = wrap(error[:, circular])
    return np.maximum(np.sqrt((error**2).mean(axis=0)), LEAST_STD)


def _targets(request: _Request, stacks: Stacks) -> np.ndarray:
    """What the network is to output: z, or what the teacher's encoder reads of the state."""
    teacher = request.teacher
    states = stacks.states[:, list(teacher.columns_of(request.demos.info.names))]
    return teacher.inputs(states) if request.config.target == "state" else teacher.encode(states)
