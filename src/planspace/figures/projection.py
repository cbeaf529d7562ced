"""Principal components, to draw a z of many dimensions in two or three."""

import numpy as np
from jaxtyping import Float


def principal_components(
    x: Float[np.ndarray, "row z"], num: int
) -> tuple[Float[np.ndarray, "row num"], Float[np.ndarray, " num"]]:
    """Project points onto their first principal components.

    Args:
        x: the points.
        num: number of components; fewer are returned if `x` has fewer columns or rows.

    Returns:
        The projected points, and the fraction of the variance that each component explains.
    """
    centred = x - x.mean(axis=0)
    _, values, axes = np.linalg.svd(centred, full_matrices=False)
    total = np.sum(values**2)
    return centred @ axes[:num].T, values[:num] ** 2 / (total if total > 0 else 1.0)
