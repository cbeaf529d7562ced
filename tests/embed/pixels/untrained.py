"""An encoder of pictures with random weights, made without JAX."""

import numpy as np

from planspace import Embedding, ImageEncoder, PictureConfig
from planspace.embed.pixels.appearance import Appearance
from planspace.embed.pixels.convolution import ConvolutionalNetwork

PICTURES = PictureConfig(width=16, height=16, frames=2)


def untrained(teacher: Embedding, *, strict: bool = False) -> ImageEncoder:
    """Make an encoder of z.

    Args:
        teacher: the embedding.
        strict: whether all pictures look strange to it.
    """
    rng = np.random.default_rng(0)

    def layer(*shape: int) -> tuple[np.ndarray, np.ndarray]:
        return rng.normal(size=shape) / 4, np.zeros(shape[-1])

    kernels = (layer(4, 4, 6, 4), layer(4, 4, 4, 4))
    dense = (layer(64, 8), layer(8, teacher.z_dim))
    return ImageEncoder(
        network=ConvolutionalNetwork(kernels, dense),
        mean=np.zeros(teacher.z_dim),
        std=np.ones(teacher.z_dim),
        target="z",
        teacher=teacher,
        pictures=PICTURES,
        frame_s=0.04,
        appearance=Appearance(np.ones(48), np.zeros((1, 48)), 1e-3 if strict else 1e3),
    )
