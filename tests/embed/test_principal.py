from dataclasses import replace

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.embed.principal import principal_components, principal_map
from planspace.errors import PlanspaceError


def test_principal_components_of_a_tilted_plane(rng: np.random.Generator) -> None:
    flat = rng.normal(size=(500, 2)) * [3.0, 1.0]
    states = flat @ np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]) + [5.0, 0.0, -2.0]
    inputs = Inputs(("a", "b", "c"), ("",) * 3, (), "raw", np.zeros(3), np.ones(3))
    embedding = principal_components(inputs, states, 2)
    z = embedding.encode(states)
    np.testing.assert_allclose(np.abs(np.corrcoef(z.T, flat.T)[:2, 2:]), np.eye(2), atol=0.1)
    np.testing.assert_allclose(embedding.decode(z), states, atol=1e-9)  # nothing lies outside the plane
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=1e-9)


def test_more_components_than_inputs_are_refused() -> None:
    inputs = Inputs(("a",), ("",), (), "raw", np.zeros(1), np.ones(1))
    with pytest.raises(PlanspaceError, match="1 inputs do not have 3 principal components"):
        principal_components(inputs, np.arange(9.0)[:, None], 3)


def test_the_linear_map_sorts_whitens_and_scales(embedding: Embedding, demos: Demos) -> None:
    plain = replace(embedding, linear_map=None)
    latent = plain.encode(demos.states)
    values = np.linalg.eigvalsh(np.cov(latent.T))[::-1]
    for whitening in (0.0, 0.3, 1.0):
        linear_map = principal_map(plain, demos.states, whitening=whitening, std=2.5)
        mapped = replace(plain, linear_map=linear_map)
        z = mapped.encode(demos.states)
        covariance = np.cov(z.T)
        after = values ** (1 - whitening)
        np.testing.assert_allclose(covariance, np.diag(after * 2.5**2 / after.mean()), atol=0.01)
        np.testing.assert_allclose(
            mapped.decode(z), plain.decode(latent), rtol=1e-3, atol=1e-3
        )  # nothing is lost
        _, sigma = plain.encode_distribution(demos.states)
        sampled = latent + sigma * np.random.default_rng(0).normal(size=(500, *sigma.shape))
        spread = linear_map(sampled, np.zeros_like(sampled))[0].std(axis=0)
        np.testing.assert_allclose(mapped.encode_distribution(demos.states)[1], spread, rtol=0.2)


def test_straight_lines_stay_straight(embedding: Embedding, demos: Demos) -> None:
    linear_map = principal_map(replace(embedding, linear_map=None), demos.states, whitening=1.0, std=1.0)
    line = np.linspace(np.zeros(3), np.array([1.0, -2.0, 0.5]), 9)
    z, _ = linear_map(line, np.ones_like(line))
    np.testing.assert_allclose(np.diff(z, n=2, axis=0), 0.0, atol=1e-5)
