"""What the encoder sees of a state. NumPy only."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from planspace.errors import PlanspaceError

MIN_STD = 1e-6
"""An input with a smaller standard deviation counts as constant."""
LARGEST = 1e15
"""Largest number in a state or in z; its square still fits in float32."""

InputType = Literal["raw", "standard", "trig"]
INPUT_TYPES: tuple[InputType, ...] = get_args(InputType)


@dataclass(frozen=True)
class Inputs:
    """Conversion of a state to the encoder's input, and back.

    `raw` leaves the numbers as they are. `standard` standardises them by the training split. `trig` first
    replaces each angle on a circle by (sin, cos), so that windings make no difference.
    """

    names: tuple[str, ...]
    """Names of the numbers of a state."""
    units: tuple[str, ...]
    """Units of the numbers."""
    circular_columns: tuple[int, ...]
    """Columns of angles on a circle [rad]."""
    form: InputType
    """`raw`, `standard` or `trig`."""
    mean: Float[np.ndarray, " input"]
    """Subtracted from each input; 0 for `raw`."""
    std: Float[np.ndarray, " input"]
    """Divides each input; 1 for `raw`."""

    @classmethod
    def fit(
        cls,
        states: Float[np.ndarray, "row state"],
        names: Sequence[str],
        units: Sequence[str],
        circular_columns: Sequence[int],
        form: InputType,
    ) -> "Inputs":
        """Compute the normaliser from training states.

        Args:
            states: the training states.
            names: names of the numbers of a state.
            units: their units.
            circular_columns: columns of angles on a circle.
            form: `raw`, `standard` or `trig`.

        Raises:
            PlanspaceError: an input is constant, so it cannot be standardised.
        """
        raw = cls(tuple(names), tuple(units), tuple(circular_columns), form, np.zeros(1), np.ones(1))
        values = raw.expand(states)
        std = values.std(axis=0)
        if (std < MIN_STD).any():
            column = raw.columns[int(np.argmin(std))]
            raise PlanspaceError(
                f"the state {names[column]!r} is constant in the training demonstrations; leave it out by "
                "listing only the others in --columns."
            )
        if form == "raw":
            mean, std = np.zeros_like(std), np.ones_like(std)
        else:
            mean = values.mean(axis=0)
        return cls(tuple(names), tuple(units), tuple(circular_columns), form, mean, std)

    @cached_property
    def columns(self) -> list[int]:
        """For each input, the column of the state that it comes from."""
        circular = self.circular_columns if self.form == "trig" else ()
        return [c for c in range(len(self.names)) for _ in range(2 if c in circular else 1)]

    @cached_property
    def _sines(self) -> list[int]:
        """The inputs that are sines; the next input is the cosine."""
        return [i for i, c in enumerate(self.columns[:-1]) if c == self.columns[i + 1]]

    def expand(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch input"]:
        """Convert states to inputs, before standardising."""
        values = np.asarray(states)
        values = values if values.dtype.kind == "f" else values.astype(float)
        if not self._sines:
            return values
        values = values[..., self.columns]
        for i in self._sines:
            values[..., i] = np.sin(values[..., i])
            values[..., i + 1] = np.cos(values[..., i + 1])
        return values

    def check_shape(self, shape: Sequence[int]) -> None:
        """Check the shape of an array of states.

        Raises:
            PlanspaceError: the states have the wrong number of columns.
        """
        if tuple(shape[-1:]) != (len(self.names),):
            raise PlanspaceError(
                f"the embedding reads states of {len(self.names)} numbers ({', '.join(self.names)}), "
                f"got {shape[-1] if len(shape) else 'a single number'}."
            )

    def __call__(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch input"]:
        """Convert states to the encoder's inputs."""
        return (self.expand(states) - self.mean) / self.std

    def invert(self, inputs: Float[np.ndarray, "*batch input"]) -> Float[np.ndarray, "*batch state"]:
        """Convert inputs back to states; with `trig`, angles are in (-pi, pi]."""
        values = inputs * self.std + self.mean
        parts, i = [], 0
        for column in range(len(self.names)):
            if self.form == "trig" and column in self.circular_columns:
                parts.append(np.arctan2(values[..., i], values[..., i + 1]))
                i += 2
            else:
                parts.append(values[..., i])
                i += 1
        return np.stack(parts, axis=-1)


def check_numbers(what: str, *arrays: np.ndarray) -> None:
    """Check that numbers are finite and not too large to compute with.

    Args:
        what: the numbers' name in the message, in the plural.
        arrays: the numbers.

    Raises:
        PlanspaceError: one is not finite, or larger than `LARGEST`.
    """
    if not all((np.abs(array) <= LARGEST).all() for array in arrays):
        raise PlanspaceError(
            f"{what} contain a number that is not finite, or larger than {LARGEST:g}: look at the data, or "
            "use another unit."
        )
