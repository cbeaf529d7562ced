"""The meaning of the numbers in a state and in a control."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import mujoco

from planspace.errors import PlanspaceError
from planspace.mjcf.compile import load_model
from planspace.physics.space import StateSpace


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
    """Joints of the model whose positions and velocities form the state."""
    mjcf: str = field(default="", repr=False)
    """The complete model as MJCF; empty if there is none."""
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
        if not self.mjcf:
            raise PlanspaceError("the dataset has no model; import it with --problem.")
        model = load_model(self.mjcf)
        return model, StateSpace.from_model(model, self.joints, kinematic=self.kinematic)


def parse_info(found: Mapping[str, Any]) -> StateInfo:
    """Build a `StateInfo` from a JSON object and check that it is consistent; extra keys are ignored.

    Raises:
        TypeError: a field is missing or has the wrong type.
        ValueError: the fields contradict each other.
    """
    known: dict[str, Any] = {f.name: found[f.name] for f in fields(StateInfo) if f.name in found}
    known = {name: tuple(value) if isinstance(value, list) else value for name, value in known.items()}
    info = StateInfo(**known)
    _check(info)
    return info


def _check(info: StateInfo) -> None:
    lists = (info.names, info.units, info.joints, info.circular_columns, info.quaternion_columns)
    if not all(isinstance(values, tuple) for values in lists) or type(info.kinematic) is not bool:
        raise TypeError("its description of the states has fields of the wrong type")
    size = len(info.names)
    texts = (*info.names, *info.units, *info.joints, info.problem, info.mjcf)
    numbers = (*info.circular_columns, *info.quaternion_columns, info.num_controls)
    if not all(isinstance(text, str) for text in texts) or not all(type(n) is int for n in numbers):
        raise TypeError("its description of the states has fields of the wrong type")
    columns = (*info.circular_columns, *(first + k for first in info.quaternion_columns for k in range(4)))
    if not size or len(info.units) != size or not all(0 <= column < size for column in columns):
        raise ValueError("its description of the states is inconsistent")
    if info.num_controls < 0:
        raise ValueError(f"the number of controls must not be negative, got {info.num_controls}")
