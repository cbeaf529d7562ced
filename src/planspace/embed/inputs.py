"""What the encoder sees of a state. NumPy only."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from planspace.errors import PlanspaceError
from planspace.physics.quaternion import ROTATION_SIZE, from_rotation_columns, rotation_columns

MIN_STD = 1e-6
"""An input with a smaller standard deviation counts as constant."""
LARGEST = 1e15
"""Largest number in a state or in z; its square still fits in float32."""

Quaternion = tuple[int, int, int, int]
"""Columns of w, x, y and z."""
InputType = Literal["raw", "standard", "trig"]
INPUT_TYPES: tuple[InputType, ...] = get_args(InputType)


@dataclass(frozen=True)
class Inputs:
    """Conversion of a state to the encoder's input, and back.

    `raw` leaves the numbers as they are. `standard` standardises them by the training split. `trig` first
    replaces each angle on a circle by (sin, cos), so that windings make no difference, and each quaternion by
    two columns of the rotation matrix, so that its sign makes none.
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
    quaternions: tuple[Quaternion, ...] = ()
    """Columns of each quaternion."""

    @classmethod
    def fit(
        cls,
        states: Float[np.ndarray, "row state"],
        names: Sequence[str],
        units: Sequence[str],
        circular_columns: Sequence[int],
        form: InputType,
        quaternions: Sequence[Quaternion] = (),
    ) -> "Inputs":
        """Compute the normaliser from training states.

        Args:
            states: the training states.
            names: names of the numbers of a state.
            units: their units.
            circular_columns: columns of angles on a circle.
            form: `raw`, `standard` or `trig`.
            quaternions: columns of each quaternion.

        Raises:
            PlanspaceError: an input is constant, so it cannot be standardised.
        """
        declared = (tuple(names), tuple(units), tuple(circular_columns), form)
        raw = cls(*declared, np.zeros(1), np.ones(1), tuple(quaternions))
        values = raw.expand(states)
        std = values.std(axis=0)
        constant = std < MIN_STD
        for i in raw._rotations:  # a rotation about one axis leaves some of its six numbers constant
            part = slice(i, i + ROTATION_SIZE)
            if not constant[part].all():
                std[part], constant[part] = np.where(constant[part], 1.0, std[part]), False
        if constant.any():
            column = raw.columns[int(np.argmin(std))]
            raise PlanspaceError(
                f"the state {names[column]!r} is constant in the training demonstrations; leave it out by "
                "listing only the others in --columns."
            )
        if form == "raw":
            mean, std = np.zeros_like(std), np.ones_like(std)
        else:
            mean = values.mean(axis=0)
        return cls(*declared, mean, std, tuple(quaternions))

    @cached_property
    def columns(self) -> list[int]:
        """For each input, the column of the state that it comes from."""
        counts = [1] * len(self.names)
        if self.form == "trig":
            for column in self.circular_columns:
                counts[column] = 2
            for w, x, y, z in self.quaternions:
                counts[w], counts[x], counts[y], counts[z] = ROTATION_SIZE, 0, 0, 0
        return [column for column, count in enumerate(counts) for _ in range(count)]

    @cached_property
    def on_manifold(self) -> list[bool]:
        """For each input, whether it is a sine, a cosine or an entry of a rotation matrix."""
        circles = self.circular_columns if self.form == "trig" else ()
        rotations = {self.columns[i] for i in self._rotations}
        return [column in circles or column in rotations for column in self.columns]

    @cached_property
    def _sines(self) -> list[int]:
        """The inputs that are sines; the next input is the cosine."""
        return [self.columns.index(column) for column in self.circular_columns] if self.form == "trig" else []

    @cached_property
    def _rotations(self) -> dict[int, list[int]]:
        """The columns of each quaternion, by the first of its inputs."""
        if self.form != "trig":
            return {}
        return {self.columns.index(quaternion[0]): list(quaternion) for quaternion in self.quaternions}

    def expand(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch input"]:
        """Convert states to inputs, before standardising."""
        states = np.asarray(states)
        states = states if states.dtype.kind == "f" else states.astype(float)
        if not self._sines and not self._rotations:
            return states
        values = states[..., self.columns]
        for i in self._sines:
            values[..., i] = np.sin(values[..., i])
            values[..., i + 1] = np.cos(values[..., i + 1])
        for i, quaternion in self._rotations.items():
            numbers = rotation_columns(*(states[..., column] for column in quaternion))
            values[..., i : i + ROTATION_SIZE] = np.stack(numbers, axis=-1)
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
        """Convert inputs back to states; with `trig`, angles are in (-pi, pi] and quaternions have w >= 0."""
        values = inputs * self.std + self.mean
        if not self._sines and not self._rotations:
            return np.ascontiguousarray(values)
        kept = [self.columns.index(c) if c in self.columns else 0 for c in range(len(self.names))]
        states = np.ascontiguousarray(values[..., kept])
        for i in self._sines:
            states[..., self.columns[i]] = np.arctan2(values[..., i], values[..., i + 1])
        for i, quaternion in self._rotations.items():
            states[..., quaternion] = from_rotation_columns(values[..., i : i + ROTATION_SIZE])
        return states


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
