"""An embedding with random weights, for tests of exported encoders."""

from dataclasses import replace

import jax.random as jr
import numpy as np

from planspace.embed.embedding import Embedding, LinearMap
from planspace.embed.inputs import Inputs, InputType
from planspace.embed.networks import GaussianNetwork

TURN = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.1], [0.0, 0.2, 2.0]])


def random_encoder(
    form: InputType, circular: tuple[int, ...], hidden: tuple[int, ...] = (64, 64)
) -> Embedding:
    """An encoder with random weights; the mean of x is large relative to its standard deviation."""
    num = 4 + (len(circular) if form == "trig" else 0)
    mean = np.linspace(0.1, 0.7, num) if form == "trig" else np.zeros(num)
    if 0 not in circular:
        mean[0] *= 7000.1
    deviation = np.linspace(0.3, 2.0, num) if form == "trig" else np.ones(num)
    inputs = Inputs(("x", "theta", "xd", "phi"), ("m", "rad", "m/s", "rad"), circular, form, mean, deviation)
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
]


def random_states(embedding: Embedding, num: int) -> np.ndarray:
    """States of the size that the encoder expects; angles over several turns."""
    rng = np.random.default_rng(0)
    states = rng.normal(size=(num, 4))
    if embedding.inputs.form == "trig":
        circular = list(embedding.inputs.circular_columns)
        states[:, circular] = rng.uniform(-50, 50, (num, len(circular)))
        if 0 not in circular:
            states[:, 0] += embedding.inputs.mean[0]
    return states.astype(np.float32)


def jacobian(embedding: Embedding, state: np.ndarray) -> np.ndarray:
    """dz / dx by central differences in float64 [z, state]."""
    weights, biases = ([array.astype(float) for array in arrays] for arrays in embedding.encoder)
    embedding = replace(embedding, encoder=(weights, biases))
    steps = 1e-6 * np.eye(len(state))
    return ((embedding.encode(state + steps) - embedding.encode(state - steps)) / 2e-6).T
