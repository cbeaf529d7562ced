"""An embedding with random weights, for tests of exported encoders."""

from dataclasses import replace

import jax.random as jr
import numpy as np

from planspace.embed.embedding import Embedding, LinearMap
from planspace.embed.inputs import Inputs, InputType, Quaternion
from planspace.embed.networks import GaussianNetwork

TURN = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.1], [0.0, 0.2, 2.0]])


def random_encoder(
    form: InputType,
    circular: tuple[int, ...],
    hidden: tuple[int, ...] = (64, 64),
    quaternions: tuple[Quaternion, ...] = (),
    names: tuple[str, ...] = ("x", "theta", "xd", "phi"),
) -> Embedding:
    """An encoder with random weights; the mean of x is large relative to its standard deviation."""
    num = len(names) + (len(circular) + 2 * len(quaternions) if form == "trig" else 0)
    mean = np.linspace(0.1, 0.7, num) if form == "trig" else np.zeros(num)
    if 0 not in circular and not quaternions:
        mean[0] *= 7000.1
    deviation = np.linspace(0.3, 2.0, num) if form == "trig" else np.ones(num)
    inputs = Inputs(names, ("",) * len(names), circular, form, mean, deviation, quaternions)
    net = GaussianNetwork(num, 3, hidden, 0.0, key=jr.key(1))
    rng = np.random.default_rng(2)
    weights = [np.asarray(w) for w in net.weights]
    biases = [rng.normal(size=len(b)).astype(np.float32) for b in net.biases]
    decoder = ([np.zeros((2 * num, 3))], [np.zeros(2 * num)])
    return Embedding(inputs, (weights, biases), decoder, 0.2, LinearMap(TURN, np.array([0.3, -1.0, 2.0])))


ENCODERS = [
    random_encoder("raw", (1,)),
    random_encoder("trig", (), (16,)),
    random_encoder("trig", (3, 1)),
    random_encoder("trig", (0, 1, 2, 3), ()),
    replace(random_encoder("trig", (1,)), linear_map=None),
    random_encoder("trig", (), quaternions=((0, 1, 2, 3),)),
    random_encoder("trig", (), quaternions=((3, 0, 1, 2),)),
]
ROTATING = random_encoder(
    "trig",
    (0, 9),
    quaternions=((2, 3, 4, 5), (13, 10, 11, 12)),
    names=("yaw", "x", "w", "i", "j", "k", "v", "y", "z", "roll", "qx", "qy", "qz", "qw"),
)
"""Angles, plain numbers, a quaternion with w first and one with w last."""


def random_states(embedding: Embedding, num: int) -> np.ndarray:
    """States of the size that the encoder expects; angles over several turns."""
    rng = np.random.default_rng(0)
    states = rng.normal(size=(num, embedding.state_dim))
    if embedding.inputs.form == "trig":
        circular = list(embedding.inputs.circular_columns)
        states[:, circular] = rng.uniform(-50, 50, (num, len(circular)))
        if 0 not in circular and not embedding.inputs.quaternions:
            states[:, 0] += embedding.inputs.mean[0]
    return states.astype(np.float32)


def jacobian(embedding: Embedding, state: np.ndarray) -> np.ndarray:
    """dz / dx by central differences in float64 [z, state]."""
    weights, biases = ([array.astype(float) for array in arrays] for arrays in embedding.encoder)
    embedding = replace(embedding, encoder=(weights, biases))
    steps = 1e-6 * np.eye(len(state))
    return ((embedding.encode(state + steps) - embedding.encode(state - steps)) / 2e-6).T
