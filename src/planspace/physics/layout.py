"""The parts of a state, and where each is in a state and in a tangent."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from planspace.physics import quaternion
from planspace.physics.joints import Kind


class Part(NamedTuple):
    """One number of a state, or the four numbers of a rotation."""

    state: int
    """Its first index in a state."""
    tangent: int
    """Its first index in a tangent."""
    kind: Literal["slide", "hinge", "circle", "rotation", "velocity", "activation"]


def state_layout(kinds: Sequence[Kind], num_velocities: int, num_activations: int = 0) -> tuple[Part, ...]:
    """Return the parts of a state in order: positions joint by joint, then velocities, then activations.

    Args:
        kinds: kinds of the joints.
        num_velocities: number of velocities in a state; 0 for a kinematic space.
        num_activations: number of activations in a state.
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
    parts += [Part(s + k, t + k, "velocity") for k in range(num_velocities)]
    s, t = s + num_velocities, t + num_velocities
    return tuple(parts + [Part(s + k, t + k, "activation") for k in range(num_activations)])


def euclidean_features(
    layout: Sequence[Part], states: Float[np.ndarray, "*batch state"], weights: Float[np.ndarray, " tangent"]
) -> Float[np.ndarray, "*batch feature"]:
    """Return states in a Euclidean space; see `StateSpace.features`."""
    parts = []
    for s, t, kind in layout:
        if kind == "circle":
            parts += [weights[t] * np.sin(states[..., s]), weights[t] * np.cos(states[..., s])]
        elif kind == "rotation":
            q = quaternion.nearest_sign(states[..., s : s + 4])
            parts += [2.0 * weights[t : t + 3].mean() * q[..., k] for k in range(4)]
        else:
            parts.append(weights[t] * states[..., s])
    return np.stack(parts, axis=-1)


def tangent_errors(
    layout: Sequence[Part], errors: Float[np.ndarray, " state"]
) -> Float[np.ndarray, " tangent"]:
    """Return root-mean-square errors of the numbers of a state as those of a tangent.

    The error of a rotation is twice that of its quaternion, and is divided among three axes.
    """
    found = []
    for s, _, kind in layout:
        if kind == "rotation":
            found += 3 * [2.0 * np.linalg.norm(errors[s : s + 4]) / np.sqrt(3.0)]
        else:
            found.append(errors[s])
    return np.array(found)


def mirrored_features(
    layout: Sequence[Part], features: Float[np.ndarray, "*batch feature"]
) -> list[Float[np.ndarray, "*batch feature"]]:
    """Return features with every other combination of quaternion signs; see `StateSpace.mirrored`."""
    images, column = [features], 0
    for _, _, kind in layout:
        if kind == "rotation":
            for image in list(images):
                flipped = image.copy()
                flipped[..., column : column + 4] *= -1.0
                images.append(flipped)
        column += {"circle": 2, "rotation": 4}.get(kind, 1)
    return images[1:]


def uniform_states(
    layout: Sequence[Part],
    low: Float[np.ndarray, " state"],
    high: Float[np.ndarray, " state"],
    rng: np.random.Generator,
    num: int,
) -> Float[np.ndarray, "num state"]:
    """Draw states uniformly between bounds; see `StateSpace.sample`."""
    states = np.empty((num, len(low)))
    for s, _, kind in layout:
        if kind == "circle":
            states[:, s] = rng.uniform(-np.pi, np.pi, num)
        elif kind == "rotation":
            states[:, s : s + 4] = quaternion.sample(rng, num)
        else:
            states[:, s] = rng.uniform(low[s], high[s], num)
    return states
