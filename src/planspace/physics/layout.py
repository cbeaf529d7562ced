"""The parts of a state, and where each is in a state and in a tangent."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

from planspace.physics.joints import Kind


class Part(NamedTuple):
    """One number of a state, or the four numbers of a rotation."""

    state: int
    """Its first index in a state."""
    tangent: int
    """Its first index in a tangent."""
    kind: Literal["slide", "hinge", "circle", "rotation", "velocity"]


def state_layout(kinds: Sequence[Kind], num_velocities: int) -> tuple[Part, ...]:
    """Return the parts of a state in order: positions joint by joint, then each velocity.

    Args:
        kinds: kinds of the joints.
        num_velocities: number of velocities in a state; 0 for a kinematic space.
    """
    parts: list[Part] = []
    s = t = 0
    for kind in kinds:
        if kind == "free":
            parts += [Part(s + k, t + k, "slide") for k in range(3)]
            s, t = s + 3, t + 3
        if kind in ("free", "ball"):
            parts.append(Part(s, t, "rotation"))
            s, t = s + 4, t + 3
        else:
            parts.append(Part(s, t, kind))
            s, t = s + 1, t + 1
    velocities = [Part(s + k, t + k, "velocity") for k in range(num_velocities)]
    return tuple(parts + velocities)
