"""The meaning of the numbers in a state and in a control."""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import mujoco

from planspace.errors import PlanspaceError
from planspace.mjcf.compile import load_model
from planspace.mjcf.model_check import MAX_ASSET_BYTES
from planspace.mjcf.source import ModelSource, model_key, parse_plain
from planspace.physics.space import StateSpace
from planspace.storage.checks import damage_error
from planspace.storage.files import read_bytes

MODEL_FOLDER = "model"
"""Folder of a dataset with the files of its model, if the model has more than one file."""


@dataclass(frozen=True)
class StateInfo:
    """Names and units of a state, and the model it belongs to."""

    names: tuple[str, ...]
    """Name of each number in a state."""
    units: tuple[str, ...]
    """Unit of each number; empty if unknown."""
    circular_columns: tuple[int, ...]
    """Columns that are angles on a circle [rad]."""
    num_controls: int
    """Number of values in a control."""
    problem: str = ""
    """Name of the planning problem; empty if there is none."""
    joints: tuple[str, ...] = ()
    """Joints of the model whose positions and velocities, with all activations, form the state."""
    source: ModelSource | None = field(default=None, repr=False)
    """The files of the model; None if there is none."""
    quaternion_columns: tuple[int, ...] = ()
    """First column of each quaternion (w, x, y, z)."""
    kinematic: bool = False
    """Whether states contain positions only and controls are velocities."""

    @classmethod
    def of_model(cls, model: mujoco.MjModel, space: StateSpace, **known: Any) -> "StateInfo":
        """Describe the states of a model.

        Args:
            model: the model.
            space: its state space.
            known: the fields that the model does not determine, such as `problem`.
        """
        return cls(
            names=space.names,
            units=space.units,
            circular_columns=space.circular_columns,
            num_controls=space.num_dofs if space.kinematic else model.nu,
            quaternion_columns=space.quaternion_columns,
            kinematic=space.kinematic,
            **known,
        )

    def compile(self) -> tuple[mujoco.MjModel, StateSpace]:
        """Compile the model and read its state space.

        Raises:
            PlanspaceError: there is no model, or it does not compile.
        """
        if self.source is None:
            raise PlanspaceError("the dataset has no model; import it with --problem.")
        model = load_model(self.source)
        return model, StateSpace.from_model(model, self.joints, kinematic=self.kinematic)

    def choose(self, names: tuple[str, ...], columns: Sequence[int | None]) -> "StateInfo":
        """Describe some columns of these states. A model needs all of its states, so there is no model.

        Args:
            names: the new names.
            columns: the column of each; None if it is not one of these states.
        """
        columns = list(columns)
        return replace(
            self,
            names=names,
            units=tuple("" if c is None else self.units[c] for c in columns),
            circular_columns=tuple(new for new, c in enumerate(columns) if c in self.circular_columns),
            quaternion_columns=tuple(
                new
                for new, c in enumerate(columns)
                if c in self.quaternion_columns and columns[new : new + 4] == list(range(c, c + 4))
            ),
            joints=(),
            source=None,
        )

    def plain(self) -> dict[str, Any]:
        """Describe the states as plain data, for a manifest or a hash."""
        described: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name != "source":
                described[f.name] = value
            else:
                described |= model_key(value) if value else {"mjcf": ""}
        return described

    def plain_with_files(self) -> dict[str, Any]:
        """Describe the states as plain data that also has the files of the model."""
        described = self.plain()
        if "model" in described:
            assert self.source is not None
            described["contents"] = {
                name: base64.b64encode(data).decode() for name, data in self.source.contents.items()
            }
        return described


def parse_info(found: Mapping[str, Any], folder: Path | None = None) -> StateInfo:
    """Build a `StateInfo` from a JSON object and check that it is consistent; extra keys are ignored.

    Args:
        found: what `StateInfo.plain` or `StateInfo.plain_with_files` returned.
        folder: the folder of the model's files; None if `found` has them.

    Raises:
        TypeError: a field is missing or has the wrong type.
        ValueError: the fields contradict each other.
        PlanspaceError: a file of the model is missing or was altered.
    """
    known: dict[str, Any] = {f.name: found[f.name] for f in fields(StateInfo) if f.name in found}
    known = {name: tuple(value) if isinstance(value, list) else value for name, value in known.items()}
    info = StateInfo(**{**known, "source": _read_source(found, folder)})
    _check(info)
    return info


def _read_source(found: Mapping[str, Any], folder: Path | None) -> ModelSource | None:
    """The model of a JSON object: `mjcf` is the text of a model in one file, `model` describes any other."""
    text = found.get("mjcf", "")
    if not isinstance(text, str):
        raise TypeError("its model is not text")
    if "model" not in found:
        return ModelSource(text) if text else None
    main, digests, held = parse_plain(found["model"])
    if folder is None:
        contents = {name: base64.b64decode(found["contents"][name], validate=True) for name in digests}
    else:
        contents = {name: _read_file(folder / name, digest) for name, digest in digests.items()}
    files = tuple((name, data) for name, data in contents.items() if name != main)
    return ModelSource(contents[main].decode(), main, files, held)


def _check(info: StateInfo) -> None:
    lists = (info.names, info.units, info.joints, info.circular_columns, info.quaternion_columns)
    if not all(isinstance(values, tuple) for values in lists) or type(info.kinematic) is not bool:
        raise TypeError("its description of the states has fields of the wrong type")
    size = len(info.names)
    texts = (*info.names, *info.units, *info.joints, info.problem)
    numbers = (*info.circular_columns, *info.quaternion_columns, info.num_controls)
    if not all(isinstance(text, str) for text in texts) or not all(type(n) is int for n in numbers):
        raise TypeError("its description of the states has fields of the wrong type")
    columns = (*info.circular_columns, *(first + k for first in info.quaternion_columns for k in range(4)))
    if not size or len(info.units) != size or not all(0 <= column < size for column in columns):
        raise ValueError("its description of the states is inconsistent")
    if info.num_controls < 0:
        raise ValueError(f"the number of controls must not be negative, got {info.num_controls}")


def _read_file(path: Path, digest: str) -> bytes:
    data = read_bytes(path, most=MAX_ASSET_BYTES)
    if hashlib.sha256(data).hexdigest() != digest:
        raise damage_error(path, "it does not have the SHA-256 that the manifest says")
    return data
