"""An encoder of pictures, for inference. NumPy only; neither JAX nor MuJoCo's renderer is needed."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import Embedding
from planspace.embed.pixels.appearance import Appearance
from planspace.embed.pixels.config import Target
from planspace.embed.pixels.convolution import ConvolutionalNetwork
from planspace.errors import UsageError
from planspace.physics.pictures import PictureConfig
from planspace.summary import html_summary, text_summary


@dataclass(frozen=True, repr=False)
class ImageEncoder:
    """A map from stacks of pictures to z: that of an embedding of states, or one learned from pictures.

    It needs no states to encode.
    """

    network: ConvolutionalNetwork
    mean: Float[np.ndarray, " out"]
    """Mean of the network's target in training."""
    std: Float[np.ndarray, " out"]
    """Standard deviation of the target in training."""
    target: Target
    """What the network was trained to output."""
    teacher: Embedding
    """The embedding of states with the same z: what the network learned from or, with the target `pictures`,
    what was fitted to the network afterwards."""
    pictures: PictureConfig
    """What the pictures must look like."""
    frame_s: float
    """Time between two frames of a stack [s]."""
    appearance: Appearance
    """The looks of the training pictures."""
    state_error: Float[np.ndarray, " state"] | None = None
    """Root-mean-square error of each number of the estimated state, on stacks that were not used in training;
    None for an encoder that was saved without."""
    about: dict[str, Any] = field(default_factory=dict)
    """Settings, seed, held-out metrics and versions."""

    @property
    def z_dim(self) -> int:
        """Number of dimensions of z."""
        return self.teacher.z_dim

    def encode(self, images: np.ndarray) -> Float[np.ndarray, "*batch z"]:
        """Compute z of stacks of pictures.

        Args:
            images: uint8 [*batch, height, width, 3 * frames], the oldest frame first, as the observation
                `pixels` of a task.

        Raises:
            UsageError: the images have another size, order of axes, number of frames or type.
        """
        return self.read(images)[0]

    def states(self, images: np.ndarray) -> Float[np.ndarray, "*batch state"]:
        """Estimate the state: the network's output, or what the teacher's decoder makes of z.

        Args:
            images: as for `encode`.

        Raises:
            UsageError: as for `encode`.
        """
        return self.read(images)[1]

    def read(
        self, images: np.ndarray
    ) -> tuple[Float[np.ndarray, "*batch z"], Float[np.ndarray, "*batch state"]]:
        """Compute z and estimate the state with one pass through the network.

        Args:
            images: as for `encode`.

        Raises:
            UsageError: as for `encode`.
        """
        found = self._outputs(images)
        if self.target == "state":
            states = self.teacher.inputs.invert(found)
            return self.teacher.encode(states), states
        return found, self.teacher.decode(found)

    def distance(self, images: np.ndarray) -> Float[np.ndarray, "*batch"]:
        """Tell how far the newest pictures are from those of the training, in looks.

        1 is the most unusual picture of the training. Much more means another camera or other colours, and
        that z is a guess.

        Args:
            images: as for `encode`.

        Raises:
            UsageError: as for `encode`.
        """
        return self.appearance.distance(self.checked(images)[..., -3:])

    @property
    def hash(self) -> str:
        """SHA-256 of weights, pictures and teacher, without `about`."""
        described = (self.target, self.pictures, self.frame_s, self.teacher.hash)
        digest = hashlib.sha256(repr(described).encode())
        for layers in (self.network.kernels, self.network.dense, [(self.mean, self.std)]):
            for array in (part for layer in layers for part in layer):
                digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def checked(self, images: np.ndarray) -> np.ndarray:
        """Return images that the network can read.

        Raises:
            UsageError: as for `encode`.
        """
        images = np.asarray(images)
        height, width, channels = shape = self.pictures.stack_shape
        if images.dtype != np.uint8:
            raise UsageError(f"images must be uint8 from 0 to 255, got {images.dtype}.")
        got = images.shape[-3:]
        if got == shape:
            return images
        if got == (channels, height, width):
            raise UsageError(
                f"images must have their channels last, {shape}, got {got}: use np.moveaxis(images, -3, -1)."
            )
        frames = self.pictures.frames
        raise UsageError(
            f"images must be stacks of {frames} frames of {height} x {width} pixels, {shape}, got "
            f"{got if len(got) == 3 else images.shape}."
        )

    def save(self, path: str | Path) -> None:
        """Save the encoder in a folder; `load_image_encoder` reads it.

        Raises:
            PlanspaceError: the folder already holds an encoder, or cannot be written.
        """
        from planspace.embed.pixels.saved import save_image_encoder

        save_image_encoder(self, Path(path))

    def _outputs(self, images: np.ndarray) -> np.ndarray:
        images = self.checked(images)
        flat = images.reshape(-1, *images.shape[-3:])
        found = np.array([self.network(stack) for stack in flat]).reshape(len(flat), len(self.mean))
        return (found * self.std + self.mean).reshape(*images.shape[:-3], -1)

    def __repr__(self) -> str:
        """A few lines: what it reads, and what it was trained on."""
        return text_summary(*self._summary())

    def _repr_html_(self) -> str:
        return html_summary(*self._summary())

    def _summary(self) -> tuple[str, dict[str, str]]:
        view = self.pictures
        title = f"Encoder of pictures in z of {self.z_dim} numbers"
        read = f"{view.frames} frames of {view.height} x {view.width} pixels, {self.frame_s:g} s apart"
        rows = {"reads": read, "trained on": self.target, "problem": self.about.get("problem", "")}
        metrics = self.about.get("metrics", {})
        return title, rows | {
            "held-out plans": ", ".join(f"{n.replace('_', ' ')} {v:.3f}" for n, v in metrics.items())
        }
