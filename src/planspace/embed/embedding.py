"""The saved artefact: an encoder one can load anywhere. NumPy alone; neither JAX nor MuJoCo is imported.

    DIR/embedding.safetensors   the weights and the normaliser
    DIR/embedding.json          what they mean: inputs, architecture, preset, seed, metrics, provenance
    DIR/README.md, log.jsonl    a model card and the curves of its training; `fit` writes them

The JSON is sealed by its own checksum and holds the SHA-256 of the weights.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float

from planspace.embed.support import Support
from planspace.errors import PlanspaceError, UsageError, quoted
from planspace.storage.arrays import Arrays, read_arrays, write_arrays
from planspace.storage.checks import CONFIG, reject_malformed
from planspace.storage.files import make_folder
from planspace.storage.json_files import read_description, write_sealed

SCHEMA = 2
WEIGHTS, DESCRIPTION = "embedding.safetensors", "embedding.json"
CARD, LOG = "README.md", "log.jsonl"
ARCHITECTURE = "relu-gaussian"
"""The one architecture there is: `embed.networks`. A file names it; it never names code."""
MIN_DEVIATION = 1e-6
LARGEST = 1e15
"""No number of a state is larger, or of z; its square still fits in float32."""
ONE_THREAD = 2**18
"""OpenBLAS makes a product of so many multiplications in the thread that asks for it. States are encoded in
blocks as small: a thread it had woken would spin on, on a core that the next step of the physics needs."""
APART = 8
"""So many rows or more on the last axis of a batch with several are multiplied apart from the others."""

InputType = Literal["raw", "standard", "trig"]
INPUT_TYPES: tuple[InputType, ...] = get_args(InputType)


@dataclass(frozen=True)
class Inputs:
    """How a state becomes the input of the encoder, and back.

    `raw` takes the numbers as they are. `standard` standardises them by the training split. `trig` first
    replaces each angle on a circle by (sin, cos), so that windings make no difference.
    """

    names: tuple[str, ...]
    """Names of the numbers of a state."""
    units: tuple[str, ...]
    """Their units."""
    circular_columns: tuple[int, ...]
    """Which of them are angles on a circle [rad]."""
    form: InputType
    """`raw`, `standard` or `trig`."""
    mean: Float[np.ndarray, " input"]
    """Subtracted from each input; 0 where `raw`."""
    deviation: Float[np.ndarray, " input"]
    """Divides each input; 1 where `raw`."""

    @classmethod
    def fit(
        cls,
        states: Float[np.ndarray, "row state"],
        names: Sequence[str],
        units: Sequence[str],
        circular_columns: Sequence[int],
        form: InputType,
    ) -> "Inputs":
        """Reads the normaliser off training states.

        Raises:
            PlanspaceError: an input is constant, so that it can be neither standardised nor learned from.
        """
        raw = cls(tuple(names), tuple(units), tuple(circular_columns), form, np.zeros(1), np.ones(1))
        values = raw.expand(states)
        deviation = values.std(axis=0)
        if (deviation < MIN_DEVIATION).any():
            column = raw.columns[int(np.argmin(deviation))]
            raise PlanspaceError(
                f"the state {names[column]!r} is constant in the training demonstrations; leave it out by "
                "naming the others in --columns."
            )
        if form == "raw":
            mean, deviation = np.zeros_like(deviation), np.ones_like(deviation)
        else:
            mean = values.mean(axis=0)
        return cls(tuple(names), tuple(units), tuple(circular_columns), form, mean, deviation)

    @cached_property
    def columns(self) -> list[int]:
        """For each input, the column of the state it comes from."""
        circular = self.circular_columns if self.form == "trig" else ()
        return [c for c in range(len(self.names)) for _ in range(2 if c in circular else 1)]

    @cached_property
    def _sines(self) -> list[int]:
        """The inputs that are sines; a cosine follows each."""
        return [i for i, c in enumerate(self.columns[:-1]) if c == self.columns[i + 1]]

    def expand(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch input"]:
        """States to inputs, before standardising."""
        values = np.asarray(states)
        values = values if values.dtype.kind == "f" else values.astype(float)
        if not self._sines:
            return values
        values = values[..., self.columns]
        for i in self._sines:
            values[..., i] = np.sin(values[..., i])
            values[..., i + 1] = np.cos(values[..., i + 1])
        return values

    def __call__(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch input"]:
        """States to the encoder's inputs."""
        return (self.expand(states) - self.mean) / self.deviation

    def invert(self, inputs: Float[np.ndarray, "*batch input"]) -> Float[np.ndarray, "*batch state"]:
        """Decoded inputs back to states; angles in (-pi, pi] where the form is `trig`."""
        values = inputs * self.deviation + self.mean
        parts, i = [], 0
        for column in range(len(self.names)):
            if self.form == "trig" and column in self.circular_columns:
                parts.append(np.arctan2(values[..., i], values[..., i + 1]))
                i += 2
            else:
                parts.append(values[..., i])
                i += 1
        return np.stack(parts, axis=-1)


@dataclass(frozen=True)
class Turn:
    """A linear map of the encoder's output, which leaves straight lines straight: z = (latent - c) M."""

    matrix: Float[np.ndarray, "z z"]
    centre: Float[np.ndarray, " z"]

    def __call__(
        self, mu: Float[np.ndarray, "*batch z"], sigma: Float[np.ndarray, "*batch z"]
    ) -> tuple[Float[np.ndarray, "*batch z"], Float[np.ndarray, "*batch z"]]:
        """Mean and deviation of each number of z, whose numbers may now be correlated."""
        return (mu - self.centre) @ self.matrix, np.sqrt(sigma**2 @ self.matrix**2)

    def invert(self, z: Float[np.ndarray, "*batch z"]) -> Float[np.ndarray, "*batch z"]:
        """Back to the encoder's output."""
        return z @ np.linalg.inv(self.matrix) + self.centre


@dataclass(frozen=True)
class Embedding:
    """A learned map from states to z, with the decoder that was trained beside it."""

    inputs: Inputs
    """What it expects of a state."""
    encoder: tuple[list[np.ndarray], list[np.ndarray]]
    """Weights [out, in] and biases [out] of each layer of q(z|x)."""
    decoder: tuple[list[np.ndarray], list[np.ndarray]]
    """The same of p(x|z)."""
    sigma_floor: float
    """Added to the decoder's deviation."""
    turn: Turn | None = None
    """What makes z of the encoder's output; None where that is z itself."""
    support: Support | None = None
    """What the demonstrations cover; None where nothing is known of them."""
    about: dict[str, Any] = field(default_factory=dict)
    """Preset, seed, metrics and provenance, as saved."""

    @property
    def z_dim(self) -> int:
        """Numbers in z."""
        return len(self.encoder[1][-1]) // 2

    @property
    def state_dim(self) -> int:
        """Numbers in a state."""
        return len(self.inputs.names)

    def _mean(self, x: Float[np.ndarray, "*batch input"]) -> Float[np.ndarray, "*batch z"]:
        *hidden, (weight, bias) = self._mean_layers
        x = x.astype(bias.dtype)
        for w, b in hidden:
            x = x @ w
            x += b
            np.maximum(x, 0.0, out=x)
        return x @ weight + bias

    @cached_property
    def _mean_layers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weights [in, out] and biases of what gives the mean, with the turn in the last; for speed."""
        weights, biases = self.encoder
        weight, bias = weights[-1][: self.z_dim].T, biases[-1][: self.z_dim]
        if self.turn is not None:
            weight, bias = weight @ self.turn.matrix, (bias - self.turn.centre) @ self.turn.matrix
        last = [(np.ascontiguousarray(weight), bias)]
        return [(np.ascontiguousarray(w.T), b) for w, b in zip(weights[:-1], biases[:-1], strict=True)] + last

    def columns_of(self, names: Sequence[str]) -> tuple[int, ...]:
        """Where, among these states, are the ones it reads.

        Args:
            names: the names of a state's numbers.

        Raises:
            UsageError: one it reads is not among them.
        """
        if missing := [name for name in self.inputs.names if name not in names]:
            raise UsageError(
                f"the embedding reads states of {self.state_dim} numbers ({', '.join(self.inputs.names)}), "
                f"these have {len(names)} ({', '.join(names)}): {missing[0]!r} is missing."
            )
        return tuple(list(names).index(name) for name in self.inputs.names)

    def encode(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch z"]:
        """The mean of q(z|x), which is what an agent observes.

        Groups of `APART` or more states, with an axis of groups in front, are rounded as each is by itself,
        whatever the others are.

        Raises:
            PlanspaceError: the states have another number of columns.
        """
        x = self.inputs(self._checked(states))
        *leading, width = x.shape
        rows = max(1, ONE_THREAD // max(weight.size for weight, _ in self._mean_layers))
        if x.size <= rows * width or (x.ndim > 2 and APART <= x.shape[-2] <= rows):
            return self._mean(x)
        x = x.reshape(-1, width)
        blocks = np.zeros((-(-len(x) // rows), rows, width))
        blocks.reshape(-1, width)[: len(x)] = x
        return self._mean(blocks).reshape(-1, self.z_dim)[: len(x)].reshape(*leading, self.z_dim)

    def encode_distribution(
        self, states: Float[np.ndarray, "*batch state"]
    ) -> tuple[Float[np.ndarray, "*batch z"], Float[np.ndarray, "*batch z"]]:
        """Mean and deviation of q(z|x).

        Raises:
            PlanspaceError: the states have another number of columns.
        """
        mu, sigma = _gaussian(self.inputs(self._checked(states)), self.encoder, 0.0)
        return (mu, sigma) if self.turn is None else self.turn(mu, sigma)

    def decode(self, z: Float[np.ndarray, "*batch z"]) -> Float[np.ndarray, "*batch state"]:
        """The state the decoder takes z to be.

        Raises:
            PlanspaceError: z has another number of columns.
        """
        z = np.asarray(z)
        if z.shape[-1:] != (self.z_dim,):
            raise PlanspaceError(f"z has {self.z_dim} numbers, got an array of shape {z.shape}.")
        latent = z if self.turn is None else self.turn.invert(z)
        return self.inputs.invert(_gaussian(latent, self.decoder, self.sigma_floor)[0])

    def distance(
        self, a: Float[np.ndarray, "*batch state"], b: Float[np.ndarray, "*batch2 state"]
    ) -> Float[np.ndarray, "*batch3"]:
        """|z(a) - z(b)|: how far apart two states are for the plans it was trained on."""
        return norm(self.encode(a) - self.encode(b))

    def outside_support(self, states: Float[np.ndarray, "*batch state"]) -> Bool[np.ndarray, "*batch"]:
        """Which states lie outside what the demonstrations cover, where z is a guess.

        Raises:
            PlanspaceError: the embedding knows nothing of its demonstrations.
        """
        if self.support is None:
            raise PlanspaceError("the embedding does not hold the support of its demonstrations.")
        return self.support.outside(self.inputs(self._checked(states)))

    def save(self, path: Path) -> None:
        """Saves it in a folder; the description is written last, and without it there is no embedding.

        Raises:
            PlanspaceError: an embedding stands there already, or it cannot be written.
        """
        if (path / DESCRIPTION).exists():
            raise PlanspaceError(f"{path} already holds an embedding; choose another --out.")
        make_folder(path)
        sha256 = write_arrays(path / WEIGHTS, self._saved_arrays())
        write_sealed(
            path / DESCRIPTION,
            {
                "schema": SCHEMA,
                "kind": "embedding",
                "architecture": ARCHITECTURE,
                "weights_sha256": sha256,
                "inputs": {
                    "names": self.inputs.names,
                    "units": self.inputs.units,
                    "circular_columns": self.inputs.circular_columns,
                    "form": self.inputs.form,
                },
                "z_dim": self.z_dim,
                "sigma_floor": self.sigma_floor,
                "support_radius": None if self.support is None else self.support.radius,
                "about": self.about,
            },
        )

    @property
    def hash(self) -> str:
        """SHA-256 of what it computes: inputs and weights, whatever is said about it."""
        digest = hashlib.sha256(
            repr(
                (self.inputs.names, self.inputs.circular_columns, self.inputs.form, self.sigma_floor)
            ).encode()
        )
        for name, array in sorted(self._arrays().items()):
            digest.update(name.encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def _checked(self, states: np.ndarray) -> np.ndarray:
        states = np.asarray(states, dtype=np.float64)
        if states.shape[-1:] != (self.state_dim,):
            raise PlanspaceError(
                f"the embedding reads states of {self.state_dim} numbers ({', '.join(self.inputs.names)}), "
                f"got {states.shape[-1] if states.ndim else 'a single number'}."
            )
        return states

    def _arrays(self) -> Arrays:
        arrays = {"mean": self.inputs.mean, "deviation": self.inputs.deviation}
        if self.turn is not None:
            arrays |= {"turn.matrix": self.turn.matrix, "turn.centre": self.turn.centre}
        for name, (weights, biases) in (("encoder", self.encoder), ("decoder", self.decoder)):
            for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
                arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"] = weight, bias
        return arrays

    def _saved_arrays(self) -> Arrays:
        if self.support is None:
            return self._arrays()
        return self._arrays() | {"support": self.support.points, "support_scale": self.support.scale}


def load_embedding(path: str | Path) -> Embedding:
    """Loads an embedding saved by `planspace embed` or `Embedding.save`.

    Args:
        path: its folder.

    Raises:
        PlanspaceError: not an embedding, a newer schema, or altered since it was saved.
        UsageError: it is no path.
    """
    if not isinstance(path, str | PathLike):
        raise UsageError(f"an embedding is given by the path of its folder, got {path!r:.60}.")
    path = Path(path)
    if not (path / DESCRIPTION).exists():
        if (path / CONFIG).exists():
            raise PlanspaceError(f"{path} is being trained, or was interrupted: run the same command again.")
        if path.name == DESCRIPTION and path.exists():
            raise PlanspaceError(f"{path} is part of an embedding; give its folder, {path.parent}.")
        raise PlanspaceError(f"{path} is not an embedding: it has no {DESCRIPTION}.")
    text = read_description(path / DESCRIPTION, kind="embedding", schema=SCHEMA)
    with reject_malformed(path / DESCRIPTION):
        embedding = _assembled(path, text)
        _try_out(embedding, text["z_dim"])
    return embedding


def _assembled(path: Path, text: dict[str, Any]) -> Embedding:
    if text["architecture"] != ARCHITECTURE:
        raise PlanspaceError(
            f"{path / DESCRIPTION} names the architecture {quoted(text['architecture'])}; this planspace "
            f"knows {ARCHITECTURE!r} alone."
        )
    arrays = read_arrays(path / WEIGHTS, sha256=str(text["weights_sha256"]))
    if any(array.dtype.kind != "f" for array in arrays.values()):
        raise TypeError("its weights are no floating point numbers")
    bad = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    if bad:
        raise PlanspaceError(f"{path / WEIGHTS}: {bad[0]} holds a number that is not finite.")
    support = None
    if "support" in arrays:
        support = Support(arrays["support"], arrays["support_scale"], float(text["support_radius"]))
    inputs = {key: text["inputs"][key] for key in ("names", "units", "circular_columns")}
    if not all(isinstance(name, str) for name in (*inputs["names"], *inputs["units"])):
        raise TypeError("the names of its inputs are no texts")
    return Embedding(
        inputs=Inputs(
            **{key: tuple(value) for key, value in inputs.items()},
            form=INPUT_TYPES[INPUT_TYPES.index(text["inputs"]["form"])],
            mean=arrays["mean"],
            deviation=arrays["deviation"],
        ),
        encoder=_layers(arrays, "encoder"),
        decoder=_layers(arrays, "decoder"),
        sigma_floor=float(text["sigma_floor"]),
        turn=Turn(arrays["turn.matrix"], arrays["turn.centre"]) if "turn.matrix" in arrays else None,
        support=support,
        about=dict(text["about"]),
    )


@np.errstate(all="ignore")  # it looks itself whether all is finite
def _try_out(embedding: Embedding, z_dim: int) -> None:
    """Sees that the parts fit together, as the description says."""
    inputs, layers = embedding.inputs, (*embedding.encoder[0], *embedding.decoder[0])
    angles = inputs.circular_columns
    if not all(type(column) is int and 0 <= column < len(inputs.names) for column in angles):
        raise ValueError("an angle is no column of the state")
    settings = embedding.about.get("settings", {})
    if "seeds" in settings and embedding.about["seed"] not in list(settings["seeds"]):
        raise ValueError("its seed is none of those that were trained")
    if not layers or len(inputs.units) != len(inputs.names) or not (inputs.deviation > 0).all():
        raise ValueError("its inputs or its networks are not whole")
    state = np.stack([np.zeros(len(inputs.names)), np.ones(len(inputs.names))])
    z = embedding.encode(state)
    decoded = embedding.decode(z)
    if z.shape != (2, z_dim) or decoded.shape != state.shape:
        raise ValueError("its networks have other sizes than it says")
    if not (np.isfinite(z).all() and np.isfinite(decoded).all()):
        raise ValueError("its networks make of ones what is not finite")
    if embedding.support is not None:
        embedding.outside_support(state)


def check_numbers(what: str, *arrays: np.ndarray) -> None:
    """Sees that numbers can be computed with.

    Raises:
        PlanspaceError: one is not finite, or larger than any that is measured.
    """
    if not all((np.abs(array) <= LARGEST).all() for array in arrays):
        raise PlanspaceError(
            f"{what} hold a number that is not finite, or beyond {LARGEST:g}: look at the data, or give them "
            "another unit."
        )


def _layers(arrays: Arrays, name: str) -> tuple[list[np.ndarray], list[np.ndarray]]:
    count = sum(key.startswith(f"{name}.") for key in arrays) // 2
    return (
        [arrays[f"{name}.{i}.weight"] for i in range(count)],
        [arrays[f"{name}.{i}.bias"] for i in range(count)],
    )


def norm(x: Float[np.ndarray, "*batch z"]) -> Float[np.ndarray, "*batch"]:
    """The length of each vector; for a single one three times as fast as `np.linalg.norm`."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", x, x)))


def _gaussian(
    x: np.ndarray, layers: tuple[list[np.ndarray], list[np.ndarray]], sigma_floor: float
) -> tuple[np.ndarray, np.ndarray]:
    """`embed.networks.GaussianNetwork` in NumPy."""
    weights, biases = layers
    x = x.astype(weights[0].dtype)
    for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
        x = np.maximum(x @ weight.T + bias, 0.0)
    mu, rho = np.split(x @ weights[-1].T + biases[-1], 2, axis=-1)
    return mu, np.where(rho > 0, rho + 1.0, np.exp(np.minimum(rho, 0.0))) + sigma_floor  # ELU + 1
