"""Unit quaternions (w, x, y, z), MuJoCo's order and conventions; q and -q are the same rotation.

A rotation vector is expressed in the body's frame: `multiply(q, exp(v))` rotates the body by |v| [rad] about
v, as MuJoCo integrates the velocity of a ball joint.
"""

import numpy as np
from jaxtyping import Float

TINY = 1e-12


def multiply(a: Float[np.ndarray, "*a 4"], b: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*c 4"]:
    """Rotation b in the frame of rotation a (the product a b); a and b broadcast."""
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
    """The inverse rotation."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def exp(v: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Convert a rotation vector [rad] to a quaternion."""
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    factor = np.where(angle > TINY, np.sin(0.5 * angle) / np.maximum(angle, TINY), 0.5)
    return np.concatenate([np.cos(0.5 * angle), factor * v], axis=-1)


def log(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3"]:
    """Convert a rotation to its shortest rotation vector [rad], of length at most pi."""
    q = nearest_sign(q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    return np.where(sine > TINY, angle / np.maximum(sine, TINY), 2.0) * q[..., 1:]


def nearest_sign(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4"]:
    """Choose between q and -q the one with w >= 0."""
    return np.where(q[..., :1] < 0.0, -q, q)


def normalise(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4"]:
    """Scale to length one; a zero quaternion becomes the identity, as in MuJoCo."""
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(length > TINY, q / np.maximum(length, TINY), np.array([1.0, 0.0, 0.0, 0.0]))


def sample(rng: np.random.Generator, num: int) -> Float[np.ndarray, "num 4"]:
    """Draw rotations uniformly."""
    return normalise(rng.normal(size=(num, 4)))
