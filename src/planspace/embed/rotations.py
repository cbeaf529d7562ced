"""Quaternions among the states that an embedding reads."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from planspace.demos.state_info import StateInfo
from planspace.embed.inputs import InputType, Quaternion
from planspace.errors import UsageError

States = Float[np.ndarray, "*batch state"]


def find_quaternions(
    info: StateInfo, names: Sequence[str], form: InputType = "standard"
) -> tuple[Quaternion, ...]:
    """Find the quaternions of a dataset among some of its states, in any order.

    Args:
        info: the states of the dataset.
        names: the chosen states.
        form: how the encoder reads them; `trig` needs all four numbers of a quaternion, or none.

    Returns:
        The columns of w, x, y and z of each quaternion whose four numbers are chosen.

    Raises:
        UsageError: the form is `trig` and a part of a quaternion is chosen.
    """
    column, found = {name: i for i, name in enumerate(names)}, []
    for first in info.quaternion_columns:
        w, x, y, z = info.names[first : first + 4]
        chosen = [name for name in (w, x, y, z) if name in column]
        if len(chosen) == 4:
            found.append((column[w], column[x], column[y], column[z]))
        elif chosen and form == "trig":
            raise UsageError(
                f"--columns has {len(chosen)} of the four numbers of the quaternion {w}, {x}, {y}, {z}: "
                f"{', '.join(chosen)}. Its sign is arbitrary, so one rotation would have two states. List "
                "all four (a constant one does no harm) or none, or use --inputs standard."
            )
    return tuple(found)


def with_signs_of(
    states: States, reference: Float[np.ndarray, "*batch2 state"], quaternions: Sequence[Quaternion]
) -> States:
    """The same states with the sign of each quaternion that is nearer to that of a reference."""
    if not quaternions:
        return states
    states = states.copy()
    for columns in map(list, quaternions):
        q, towards = states[..., columns], reference[..., columns]
        states[..., columns] = np.where((q * towards).sum(axis=-1, keepdims=True) < 0, -q, q)
    return states


def with_one_sign(
    states: Float[np.ndarray, "row state"], quaternions: Sequence[Quaternion]
) -> Float[np.ndarray, "row state"]:
    """The same states with quaternions on one side of a plane; their signs in `states` make no difference."""
    axes = np.zeros(states.shape[-1])
    for columns in map(list, quaternions):
        q = states[:, columns]
        axes[columns] = np.linalg.eigh(q.T @ q)[1][:, -1]
    return with_signs_of(states, axes, quaternions)
