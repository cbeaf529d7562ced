"""How much a picture looks like those of the training: other cameras and colours are far away."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from planspace.embed.pixels.config import BLOCK

COMPONENTS = 48
"""Number of principal components."""
MOST_PICTURES = 3000
"""Number of training pictures that are looked at."""


@dataclass(frozen=True)
class Appearance:
    """The principal components of training pictures, as means over blocks of 4 x 4 pixels."""

    mean: Float[np.ndarray, " block"]
    components: Float[np.ndarray, "component block"]
    limit: float
    """Largest residual of training pictures that the components were not fitted to."""

    @classmethod
    def fit(cls, pictures: UInt8[np.ndarray, "picture height width 3"]) -> "Appearance":
        """Fit the components to half of the pictures, and measure the residual on the other half."""
        blocks = _block_means(pictures[:MOST_PICTURES])
        fitted, others = blocks[::2], blocks[1::2]
        mean = fitted.mean(axis=0)
        _, _, components = np.linalg.svd(fitted - mean, full_matrices=False)
        found = cls(mean, components[: min(COMPONENTS, len(fitted) // 2)], 1.0)
        limit = found.distance_of_blocks(others).max(initial=1e-3)
        return cls(found.mean, found.components, float(limit))

    def distance(self, pictures: UInt8[np.ndarray, "*batch height width 3"]) -> Float[np.ndarray, "*batch"]:
        """Residual of pictures, in units of the largest one in training; above 1, they look different."""
        return self.distance_of_blocks(_block_means(pictures))

    def distance_of_blocks(self, blocks: Float[np.ndarray, "*batch block"]) -> Float[np.ndarray, "*batch"]:
        """The same for means over blocks."""
        moved = blocks - self.mean
        rest = moved - (moved @ self.components.T) @ self.components
        return np.asarray(np.sqrt(np.mean(rest**2, axis=-1)) / self.limit)


def in_blocks(pictures: Any) -> Any:
    """Divide pictures of NumPy or JAX into blocks of pixels, whose rows and columns are axes -4 and -2."""
    *batch, height, width, channels = pictures.shape
    return pictures.reshape(*batch, height // BLOCK, BLOCK, width // BLOCK, BLOCK, channels)


def _block_means(pictures: UInt8[np.ndarray, "*batch height width 3"]) -> Float[np.ndarray, "*batch block"]:
    means = in_blocks(pictures).mean(axis=(-4, -2), dtype=np.float32)
    return means.reshape(*pictures.shape[:-3], -1) / np.float32(255)
