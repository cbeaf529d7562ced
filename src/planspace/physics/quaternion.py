"""Unit quaternions (w, x, y, z), MuJoCo's order and conventions; q and -q are the same rotation.

A rotation vector is taken in the body's own frame: `multiply(q, exp(v))` turns the body by |v| [rad] about v,
as MuJoCo integrates the velocity of a ball joint.
"""

import numpy as np
from jaxtyping import Float

TINY = 1e-12


def multiply(a: Float[np.ndarray, "*a 4"], b: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*c 4"]:
    """The rotation b, in the frame that a makes; the two broadcast."""
    w, x, y, z = (a[..., i] for i in range(4))
    s, t, u, v = (b[..., i] for i in range(4))
    return np.stack(
        [
            w * s - x * t - y * u - z * v,
            w * t + x * s + y * v - z * u,
            w * u - x * v + y * s + z * t,
            w * v + x * u - y * t + z * s,
        ],
        axis=-1,
    )


def conjugate(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4"]:
    """The rotation back."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def exp(v: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 4"]:
    """The rotation by a rotation vector [rad]."""
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    factor = np.where(angle > TINY, np.sin(0.5 * angle) / np.maximum(angle, TINY), 0.5)
    return np.concatenate([np.cos(0.5 * angle), factor * v], axis=-1)


def log(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3"]:
    """The shortest rotation vector [rad] of a rotation, at most pi long."""
    q = nearest_sign(q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    return np.where(sine > TINY, angle / np.maximum(sine, TINY), 2.0) * q[..., 1:]


def nearest_sign(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4"]:
    """The one of q and -q with w >= 0."""
    return np.where(q[..., :1] < 0.0, -q, q)


def normalise(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4"]:
    """Q at length one; a zero quaternion becomes no rotation, as in MuJoCo."""
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(length > TINY, q / np.maximum(length, TINY), np.array([1.0, 0.0, 0.0, 0.0]))


def sample(rng: np.random.Generator, num: int) -> Float[np.ndarray, "num 4"]:
    """Rotations drawn uniformly."""
    return normalise(rng.normal(size=(num, 4)))
