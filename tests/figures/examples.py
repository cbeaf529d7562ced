"""Embeddings and demonstrations with values that are easy to check."""

import io

import matplotlib.figure
import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.recording import recorded
from planspace.demos.state_info import StateInfo
from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs

NAMES, UNITS = ("p", "q", "r", "s", "t"), ("m", "", "m/s", "rad/s", "N")


def linear(z_dim: int, names: tuple[str, ...] = NAMES) -> Embedding:
    """An embedding whose z is the first numbers of the state, the first one doubled."""
    n = len(names)
    weight = np.concatenate([np.eye(z_dim, n), np.zeros((z_dim, n))])
    weight[0, 0] = 2.0
    inputs = Inputs(names, UNITS[:n], (), "raw", np.zeros(n), np.ones(n))
    return Embedding(
        inputs, ([weight], [np.zeros(2 * z_dim)]), ([np.zeros((2 * n, z_dim))], [np.zeros(2 * n)]), 0.2
    )


def random_demos(lengths: tuple[int, ...], names: tuple[str, ...] = NAMES, problem: str = "") -> Demos:
    """Random walks with a time step of 0.1 s."""
    rng = np.random.default_rng(0)
    episodes = [
        recorded(rng.normal(size=(n, len(names))).cumsum(axis=0), np.zeros((n - 1, 0)), np.arange(n) * 0.1, i)
        for i, n in enumerate(lengths)
    ]
    info = StateInfo(names, (*UNITS, "")[: len(names)], (), 0, problem=problem)
    return Demos.from_episodes(info, episodes)


def rendered(figure: matplotlib.figure.Figure) -> matplotlib.figure.Figure:
    """Draw the figure once, so that a Matplotlib warning fails the test."""
    for kind in ("png", "svg"):
        figure.savefig(io.BytesIO(), format=kind, dpi=30)
    return figure
