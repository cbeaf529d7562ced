"""Leave out points of long paths, so that figures stay small whatever the length of a recording."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int


def thin(points: Float[np.ndarray, "time axis"], most: int) -> Int[np.ndarray, " kept"]:
    """Choose points that keep the outline of a path: first, last, and extremes along each axis.

    The path is divided into equal pieces. In each piece, the smallest and the largest value on each axis are
    kept, so a spike of a single state stays visible.

    Args:
        points: the path.
        most: about the largest number of points to keep; a shorter path is kept whole.

    Returns:
        The rows to keep, sorted.
    """
    length, num_axes = points.shape
    if length <= most:
        return np.arange(length)
    num_pieces = max(1, (most - 2) // (2 * num_axes))
    size = -(-length // num_pieces)
    rows = np.minimum(np.arange(num_pieces * size), length - 1).reshape(num_pieces, size)
    pieces = points[rows]
    extremes = np.stack([pieces.argmin(axis=1), pieces.argmax(axis=1)])
    kept = rows[np.arange(num_pieces)[:, None], extremes]
    return np.unique(np.concatenate([[0, length - 1], kept.ravel()]))


def thin_paths(
    paths: Sequence[Float[np.ndarray, "_time axis"]], most: int
) -> list[Int[np.ndarray, " _kept"]]:
    """Choose points of several paths, about `most` in total; each path keeps the same fraction."""
    total = sum(map(len, paths))
    if total <= most:
        return [np.arange(len(path)) for path in paths]
    return [thin(path, max(2, len(path) * most // total)) for path in paths]
