"""A learned map from states to z: its mathematics. NumPy only; neither JAX nor MuJoCo is imported."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from planspace.embed.about import About
from planspace.embed.inputs import Inputs
from planspace.embed.mlp import Layer, forward
from planspace.embed.support import Support
from planspace.embed.time_head import TimeHead, TimeInput, quasimetric
from planspace.errors import PlanspaceError, UsageError, quoted
from planspace.storage.arrays import Arrays
from planspace.summary import html_summary, text_summary

ONE_THREAD = 2**18
"""OpenBLAS computes a product with at most this many multiplications in the calling thread. States are
encoded in blocks of that size: a thread that it had woken would keep a core busy that physics needs next."""
SEPARATE_ROWS = 8
"""Batches with at least this many rows on the last axis are multiplied one by one."""

Network = tuple[list[np.ndarray], list[np.ndarray]]
"""Weights [out, in] and biases [out] of each layer."""


@dataclass(frozen=True)
class LinearMap:
    """A linear map of the encoder's output; straight lines stay straight: z = (latent - c) M."""

    matrix: Float[np.ndarray, "z z"]
    centre: Float[np.ndarray, " z"]

    def __call__(
        self, mu: Float[np.ndarray, "*batch z"], sigma: Float[np.ndarray, "*batch z"]
    ) -> tuple[Float[np.ndarray, "*batch z"], Float[np.ndarray, "*batch z"]]:
        """Mean and standard deviation of each number of z; the numbers may be correlated."""
        return (mu - self.centre) @ self.matrix, np.sqrt(sigma**2 @ self.matrix**2)

    def invert(self, z: Float[np.ndarray, "*batch z"]) -> Float[np.ndarray, "*batch z"]:
        """Convert z back to the encoder's output."""
        return z @ np.linalg.inv(self.matrix) + self.centre


@dataclass(frozen=True, repr=False)
class Embedding:
    """A learned map from states to z, and the decoder that was trained with it."""

    inputs: Inputs
    """How a state becomes the encoder's input."""
    encoder: Network
    """Weights [out, in] and biases [out] of each layer of q(z|x)."""
    decoder: Network
    """The same for p(x|z)."""
    sigma_floor: float
    """Added to the decoder's standard deviation."""
    linear_map: LinearMap | None = None
    """Maps the encoder's output to z; None if the output is z itself."""
    support: Support | None = None
    """The region that the demonstrations cover; None if it is not known."""
    about: About | None = None
    """Preset, seed, settings, metrics and versions; None if `fit_embedding` did not make the embedding."""
    time_head: TimeHead | None = None
    """Estimates shortest times; None if it was not trained."""

    @property
    def z_dim(self) -> int:
        """Number of dimensions of z."""
        return len(self.encoder[1][-1]) // 2

    @property
    def state_dim(self) -> int:
        """Number of values in a state."""
        return len(self.inputs.names)

    def _mean(self, x: Float[np.ndarray, "*batch input"]) -> Float[np.ndarray, "*batch z"]:
        return forward(self._mean_layers, x.astype(self._mean_layers[-1][1].dtype), _relu)

    @cached_property
    def _mean_layers(self) -> list[Layer]:
        """The layers that give the mean, with the linear map multiplied into the last one, for speed."""
        weights, biases = self.encoder
        weight, bias = weights[-1][: self.z_dim].T, biases[-1][: self.z_dim]
        if self.linear_map is not None:
            matrix, centre = self.linear_map.matrix, self.linear_map.centre
            weight, bias = weight @ matrix, (bias - centre) @ matrix
        hidden = [(np.ascontiguousarray(w.T), b) for w, b in zip(weights[:-1], biases[:-1], strict=True)]
        return [*hidden, (np.ascontiguousarray(weight), bias)]

    def columns_of(self, names: Sequence[str], units: Sequence[str] = ()) -> tuple[int, ...]:
        """Find the columns that the embedding reads.

        Args:
            names: the names of a state's numbers.
            units: their units, if they are known; `""` stands for one that is not.

        Raises:
            UsageError: a state that the embedding reads is missing, or has another unit.
        """
        if missing := [name for name in self.inputs.names if name not in names]:
            raise UsageError(
                f"the embedding reads states of {self.state_dim} numbers ({', '.join(self.inputs.names)}), "
                f"these have {len(names)} ({', '.join(names)}): {missing[0]!r} is missing."
            )
        columns = tuple(list(names).index(name) for name in self.inputs.names)
        given = [units[column] for column in columns] if units else []
        for name, own, unit in zip(self.inputs.names, self.inputs.units, given, strict=False):
            if own and unit and own != unit:
                raise UsageError(
                    f"the embedding reads {name!r} in {own}, but here it is in {unit}; train it on "
                    "demonstrations with these units."
                )
        return columns

    def encode(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch z"]:
        """Compute the mean of q(z|x), which agents observe.

        If there is an axis of groups in front of at least `SEPARATE_ROWS` states, each group is rounded as if
        it were encoded alone.

        Raises:
            PlanspaceError: the states have the wrong number of columns.
        """
        x = self.inputs(self._checked(states))
        *leading, width = x.shape
        rows = max(1, ONE_THREAD // max(weight.size for weight, _ in self._mean_layers))
        if x.size <= rows * width or (x.ndim > 2 and SEPARATE_ROWS <= x.shape[-2] <= rows):
            return self._mean(x)
        x = x.reshape(-1, width)
        blocks = np.zeros((-(-len(x) // rows), rows, width))
        blocks.reshape(-1, width)[: len(x)] = x
        return self._mean(blocks).reshape(-1, self.z_dim)[: len(x)].reshape(*leading, self.z_dim)

    def encode_distribution(
        self, states: Float[np.ndarray, "*batch state"]
    ) -> tuple[Float[np.ndarray, "*batch z"], Float[np.ndarray, "*batch z"]]:
        """Compute the mean and the standard deviation of q(z|x).

        Raises:
            PlanspaceError: the states have the wrong number of columns.
        """
        mu, sigma = _gaussian(self.inputs(self._checked(states)), self.encoder, 0.0)
        return (mu, sigma) if self.linear_map is None else self.linear_map(mu, sigma)

    def decode(self, z: Float[np.ndarray, "*batch z"]) -> Float[np.ndarray, "*batch state"]:
        """Compute the mean of p(x|z), as a state.

        Raises:
            PlanspaceError: z has the wrong number of columns.
        """
        z = np.asarray(z)
        if z.shape[-1:] != (self.z_dim,):
            raise PlanspaceError(f"z has {self.z_dim} numbers, got an array of shape {z.shape}.")
        latent = z if self.linear_map is None else self.linear_map.invert(z)
        return self.inputs.invert(_gaussian(latent, self.decoder, self.sigma_floor)[0])

    def distance(
        self, a: Float[np.ndarray, "*batch state"], b: Float[np.ndarray, "*batch2 state"]
    ) -> Float[np.ndarray, "*batch3"]:
        """|z(a) - z(b)|: the distance between two states along plans like those of the training."""
        return norm(self.encode(a) - self.encode(b))

    def time_to_go(
        self, start: Float[np.ndarray, "*batch state"], goal: Float[np.ndarray, "*batch2 state"]
    ) -> Float[np.ndarray, "*batch3"]:
        """Estimate the shortest time from one state to another [s].

        It is never negative, 0 from a state to itself, and meets the triangle inequality. Unlike `distance`,
        it differs between there and back.

        Args:
            start: where the robot is.
            goal: where it is to be; any state, not only the goal of the demonstrations.

        Raises:
            PlanspaceError: the embedding has no time head, or the states have the wrong number of columns.
        """
        if self.time_head is None:
            raise PlanspaceError(
                "the embedding has no time head; train it with `planspace embed --time-head`, or with "
                "`fit_embedding(..., time_head=True)`."
            )
        head = self.time_head
        a, b = (head.features(self.time_inputs(x, head.reads)) for x in (start, goal))
        return quasimetric(a, b)

    def time_inputs(
        self, states: Float[np.ndarray, "*batch state"], reads: TimeInput
    ) -> Float[np.ndarray, "*batch read"]:
        """What a time head reads of states.

        Raises:
            PlanspaceError: the states have the wrong number of columns.
        """
        if reads == "z":
            return self.encode(states)
        inputs = self.inputs(self._checked(states))
        return inputs if reads == "state" else np.concatenate([inputs, self.encode(states)], axis=-1)

    def outside_support(self, states: Float[np.ndarray, "*batch state"]) -> Bool[np.ndarray, "*batch"]:
        """Tell which states lie outside the region that the demonstrations cover, where z is a guess.

        Raises:
            PlanspaceError: the embedding does not know that region.
        """
        if self.support is None:
            raise PlanspaceError("the embedding does not contain the support of its demonstrations.")
        return self.support.outside(self.inputs(self._checked(states)))

    def require_about(self) -> About:
        """Return `about`.

        Raises:
            PlanspaceError: `fit_embedding` did not make the embedding.
        """
        if self.about is None:
            raise PlanspaceError(
                "the embedding does not say how it was trained; make it with `fit_embedding`."
            )
        return self.about

    def save(self, path: str | Path) -> None:
        """Save the embedding in a folder; `load_embedding` reads it.

        Raises:
            PlanspaceError: the folder already holds an embedding, or cannot be written.
        """
        from planspace.embed.saved_embedding import save_embedding

        save_embedding(self, Path(path))

    def __repr__(self) -> str:
        """A few lines: what it reads, how it was trained, how straight plans are."""
        return text_summary(*self._summary())

    def _repr_html_(self) -> str:
        return html_summary(*self._summary())

    def _summary(self) -> tuple[str, dict[str, str]]:
        title = f"Embedding of states of {self.state_dim} numbers in z of {self.z_dim} numbers"
        rows = {"reads": ", ".join(self.inputs.names), "inputs": self.inputs.form}
        if self.time_head is not None:
            rows["time to go"] = f"estimated from {self.time_head.reads}"
        if self.about is None:
            return title, rows
        settings, metrics = self.about.settings, self.about.metrics["test"]
        shown = ("straightness", "midpoint_error", "decoded_error")
        return title, rows | {
            "problem": self.about.problem or "",
            "objective": settings.fit.get("objective", {}).get("name", ""),
            "preset": self.about.preset,
            "seed": f"{self.about.seed} of {', '.join(map(str, settings.seeds))}",
            "test split": ", ".join(
                f"{n.replace('_', ' ')} {metrics[n]:.3f}" for n in shown if metrics.get(n) is not None
            ),
        }

    @property
    def hash(self) -> str:
        """SHA-256 of inputs and weights, without `about`."""
        inputs = self.inputs
        described = (inputs.names, inputs.circular_columns, inputs.form, self.sigma_floor)
        digest = hashlib.sha256(repr(described).encode())
        if inputs.quaternions:
            digest.update(repr(inputs.quaternions).encode())
        for name, array in sorted(self.arrays().items()):
            digest.update(name.encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def _checked(self, states: np.ndarray) -> np.ndarray:
        try:
            states = np.asarray(states, dtype=np.float64)
        except (TypeError, ValueError):
            raise UsageError(f"states must be an array of numbers, got {quoted(states)}.") from None
        self.inputs.check_shape(states.shape)
        return states

    def arrays(self) -> Arrays:
        """Inputs and weights by their names in files."""
        arrays = {"mean": self.inputs.mean, "deviation": self.inputs.std}
        if self.linear_map is not None:
            arrays |= {"turn.matrix": self.linear_map.matrix, "turn.centre": self.linear_map.centre}
        networks = {"encoder": self.encoder, "decoder": self.decoder}
        if self.time_head is not None:
            networks["time_head"] = (self.time_head.weights, self.time_head.biases)
        for name, (weights, biases) in networks.items():
            for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
                arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"] = weight, bias
        return arrays


def norm(x: Float[np.ndarray, "*batch z"]) -> Float[np.ndarray, "*batch"]:
    """Length of each vector; for a single one three times as fast as `np.linalg.norm`."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", x, x)))


def _relu(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0.0, out=x)


def _gaussian(x: np.ndarray, network: Network, sigma_floor: float) -> tuple[np.ndarray, np.ndarray]:
    """`embed.networks.GaussianNetwork` in NumPy."""
    weights, biases = network
    layers = [(weight.T, bias) for weight, bias in zip(weights, biases, strict=True)]
    mu, rho = np.split(forward(layers, x.astype(weights[0].dtype), _relu), 2, axis=-1)
    return mu, np.where(rho > 0, rho + 1.0, np.exp(np.minimum(rho, 0.0))) + sigma_floor  # ELU + 1
