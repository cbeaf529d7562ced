"""The observation space of an agent that sees z: a `Box` that knows which embedding computes z."""

from typing import Any

import numpy as np
from gymnasium.spaces import Box

HASH_DIGITS = 12
"""Digits of the hash that are printed."""


class EmbeddingBox(Box):
    """A `Box` whose numbers, or last numbers, are z.

    Two of them are equal only if the same embedding computes z. Libraries that compare the space of a saved
    agent with that of the environment, as Stable-Baselines3 does, therefore refuse another embedding of the
    same size. A plain `Box` is equal if its shape, type and limits are.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, dtype: Any, embedding_hash: str):
        """Make a space.

        Args:
            low: lower limits.
            high: upper limits.
            dtype: type of the numbers.
            embedding_hash: `Embedding.hash` of the embedding that computes z.
        """
        super().__init__(low, high, dtype=dtype)
        self.embedding_hash = embedding_hash

    def __eq__(self, other: object, /) -> bool:
        """Tell whether another space has the same shape, type, limits and embedding."""
        same = not isinstance(other, EmbeddingBox) or other.embedding_hash == self.embedding_hash
        return same and super().__eq__(other)

    def __repr__(self) -> str:
        """Describe the space with the first digits of the hash."""
        return f"{super().__repr__()[:-1]}, embedding {self.embedding_hash[:HASH_DIGITS]})"


def z_space(size: int, embedding_hash: str) -> EmbeddingBox:
    """Return the space of z.

    Args:
        size: number of values in z.
        embedding_hash: `Embedding.hash` of the embedding.
    """
    limit = np.full(size, np.inf, np.float32)
    return EmbeddingBox(-limit, limit, np.float32, embedding_hash)


def append_z(space: Box, size: int, embedding_hash: str) -> EmbeddingBox:
    """Return a flat space followed by z; numbers that are not floats become float32.

    Args:
        space: the space of the observation.
        size: number of values in z.
        embedding_hash: `Embedding.hash` of the embedding.
    """
    dtype: Any = space.dtype if np.issubdtype(space.dtype, np.floating) else np.float32  # pyright: ignore
    limit = np.full(size, np.inf)
    low, high = np.append(space.low, -limit).astype(dtype), np.append(space.high, limit).astype(dtype)
    return EmbeddingBox(low, high, dtype, embedding_hash)
