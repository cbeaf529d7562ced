"""An encoder of pictures as a folder.

    DIR/encoder.safetensors   the weights, the normaliser and the looks of the training pictures
    DIR/encoder.json          what they mean: pictures, architecture, target, settings, metrics, provenance
    DIR/teacher/              the embedding of states with the same z: its teacher, or its twin
    DIR/README.md, log.jsonl  model card and training log, written by `fit_image_encoder`

The JSON contains its own checksum and the SHA-256 of the weights. Loading does not import JAX.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from planspace.embed.pixels.appearance import Appearance
from planspace.embed.pixels.config import TARGETS, check_channels
from planspace.embed.pixels.convolution import KERNEL, ConvolutionalNetwork
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.embed.saved_embedding import DESCRIPTION as TEACHER_DESCRIPTION
from planspace.embed.saved_embedding import load_embedding
from planspace.errors import PlanspaceError, quoted
from planspace.physics.pictures import PictureConfig
from planspace.storage.arrays import Arrays, read_arrays, write_arrays
from planspace.storage.checks import CONFIG, reject_malformed
from planspace.storage.files import make_folder
from planspace.storage.json_files import read_description, read_json, write_sealed

SCHEMA = 1
WEIGHTS, DESCRIPTION, TEACHER = "encoder.safetensors", "encoder.json", "teacher"
ARCHITECTURE = "relu-convolutional"
"""The only architecture: `embed.pixels.convolution`. A file names it; it never names code."""


def save_image_encoder(encoder: ImageEncoder, path: Path) -> None:
    """Save an encoder in a folder. The description is written last; without it there is no encoder.

    Raises:
        PlanspaceError: the folder already holds an encoder, or cannot be written.
    """
    if (path / DESCRIPTION).exists():
        raise PlanspaceError(f"{path} already holds an encoder of pictures; choose another --out.")
    make_folder(path)
    if not (path / TEACHER / TEACHER_DESCRIPTION).exists():
        encoder.teacher.save(path / TEACHER)
    description = {
        "schema": SCHEMA,
        "kind": "image-encoder",
        "architecture": ARCHITECTURE,
        "weights_sha256": write_arrays(path / WEIGHTS, _arrays(encoder)),
        "target": encoder.target,
        "pictures": asdict(encoder.pictures),
        "frame_s": encoder.frame_s,
        "appearance_limit": encoder.appearance.limit,
        "teacher": encoder.teacher.hash,
        "about": encoder.about,
    }
    write_sealed(path / DESCRIPTION, description)


def load_image_encoder(path: str | Path) -> ImageEncoder:
    """Load an encoder that `planspace pixels`, `fit_image_encoder` or `ImageEncoder.save` wrote.

    Args:
        path: its folder.

    Raises:
        PlanspaceError: the folder is not an encoder of pictures, has a newer schema, or was altered.
    """
    path = Path(path)
    if not (path / DESCRIPTION).exists():
        if (path / CONFIG).exists() and "teacher" in read_json(path / CONFIG):
            raise PlanspaceError(
                f"{path} is not finished: its training is running or was interrupted; repeat the command."
            )
        raise PlanspaceError(
            f"{path} is not an encoder of pictures: it contains no {DESCRIPTION}. "
            "`planspace pixels` makes one."
        )
    text = read_description(path / DESCRIPTION, kind="image-encoder", schema=SCHEMA)
    with reject_malformed(path / DESCRIPTION):
        encoder = _assemble(path, text)
        _check(encoder, text)
    return encoder


def _assemble(path: Path, text: dict[str, Any]) -> ImageEncoder:
    if text["architecture"] != ARCHITECTURE:
        raise PlanspaceError(
            f"{path / DESCRIPTION} names the architecture {quoted(text['architecture'])}; this planspace "
            f"only knows {ARCHITECTURE!r}."
        )
    arrays = read_arrays(path / WEIGHTS, sha256=str(text["weights_sha256"]))
    if any(array.dtype.kind != "f" or not np.isfinite(array).all() for array in arrays.values()):
        raise ValueError("a weight is not a finite number")
    return ImageEncoder(
        network=ConvolutionalNetwork(_layers(arrays, "kernel"), _layers(arrays, "dense")),
        mean=arrays["mean"],
        std=arrays["std"],
        target=TARGETS[TARGETS.index(text["target"])],
        teacher=load_embedding(path / TEACHER),
        pictures=PictureConfig(**text["pictures"]),
        frame_s=float(text["frame_s"]),
        appearance=Appearance(
            arrays["looks.mean"], arrays["looks.components"], float(text["appearance_limit"])
        ),
        state_error=arrays.get("state_error"),
        about=dict(text["about"]),
    )


def _check(encoder: ImageEncoder, text: dict[str, Any]) -> None:
    """Check that the parts fit together."""
    if encoder.teacher.hash != text["teacher"]:
        raise ValueError("its teacher is another embedding")
    shapes = [kernel.shape for kernel, _ in encoder.network.kernels]
    check_channels(tuple(shape[-1] for shape in shapes), encoder.pictures)
    if any(shape[:2] != (KERNEL, KERNEL) for shape in shapes) or encoder.frame_s <= 0:
        raise ValueError("its kernels or its frame time are wrong")
    if encoder.appearance.limit <= 0 or not (encoder.std > 0).all():
        raise ValueError("its scales are not positive")
    black = np.zeros(encoder.pictures.stack_shape, dtype=np.uint8)
    z, state = encoder.encode(black), encoder.states(black)
    if z.shape != (encoder.z_dim,) or state.shape != (encoder.teacher.state_dim,):
        raise ValueError("the sizes of its network do not match its teacher")
    error = encoder.state_error
    if error is not None and (error.shape != state.shape or not (error > 0).all()):
        raise ValueError("the errors of its states are wrong")
    if not np.isfinite([*z, *state, encoder.distance(black)]).all():
        raise ValueError("it gives numbers that are not finite")


def _arrays(encoder: ImageEncoder) -> Arrays:
    looks = encoder.appearance
    arrays = {"mean": encoder.mean, "std": encoder.std}
    arrays |= {"looks.mean": looks.mean, "looks.components": looks.components}
    if encoder.state_error is not None:
        arrays["state_error"] = encoder.state_error
    for name, layers in (("kernel", encoder.network.kernels), ("dense", encoder.network.dense)):
        for i, (weight, bias) in enumerate(layers):
            arrays |= {f"{name}.{i}.weight": weight, f"{name}.{i}.bias": bias}
    return arrays


def _layers(arrays: Arrays, name: str) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    count = sum(key.startswith(f"{name}.") for key in arrays) // 2
    return tuple((arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"]) for i in range(count))
