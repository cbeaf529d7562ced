"""Linear maps in closed form: principal components as an embedding, and as axes of a trained z."""

import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import Embedding, LinearMap
from planspace.embed.inputs import Inputs
from planspace.errors import PlanspaceError

SMALLEST = 1e-8
"""Variances below this fraction of the largest are not scaled up."""


def principal_components(inputs: Inputs, states: Float[np.ndarray, "row state"], z_dim: int) -> Embedding:
    """Compute the first principal components of the inputs, and their least-squares inverse.

    Args:
        inputs: what the encoder sees of a state.
        states: the training states.
        z_dim: how many components.

    Raises:
        PlanspaceError: there are fewer inputs than components.
    """
    x = inputs(states)
    if z_dim > x.shape[1]:
        raise PlanspaceError(
            f"{x.shape[1]} inputs do not have {z_dim} principal components; choose a smaller --z-dim or "
            "another objective."
        )
    mean = x.mean(axis=0)
    _, _, directions = np.linalg.svd(x - mean, full_matrices=False)
    v = directions[:z_dim]
    encoder = np.concatenate([v, np.zeros_like(v)])  # mu, then rho = 0: a standard deviation of 1
    decoder = np.concatenate([v.T, np.zeros_like(v.T)])
    return Embedding(
        inputs,
        ([encoder], [np.concatenate([-v @ mean, np.zeros(z_dim)])]),
        ([decoder], [np.concatenate([mean, np.zeros(len(mean))])]),
        sigma_floor=0.0,
    )


def principal_map(
    embedding: Embedding, states: Float[np.ndarray, "row state"], *, whitening: float, std: float
) -> LinearMap:
    """Compute the map of z to its principal directions, the largest first, partly whitened and scaled.

    Args:
        embedding: the embedding, without a linear map.
        states: the training states.
        whitening: the standard deviation s of a direction over these states becomes s^(1 - whitening).
        std: root mean square of the standard deviations afterwards.
    """
    mu = embedding.encode(states)
    centre = mu.mean(axis=0)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov((mu - centre).T)))
    values, vectors = np.maximum(values[::-1], SMALLEST * max(values.max(), SMALLEST)), vectors[:, ::-1]
    after = values ** ((1 - whitening) / 2)
    scale = std / np.sqrt(np.mean(after**2))
    matrix = scale * vectors * values ** (-whitening / 2)
    return LinearMap(matrix.astype(np.float32), centre.astype(np.float32))
