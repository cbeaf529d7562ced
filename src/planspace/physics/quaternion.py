"""Unit quaternions (w, x, y, z), MuJoCo's order and conventions; q and -q are the same rotation.

A rotation vector is expressed in the body's frame: `multiply(q, exp(v))` rotates the body by |v| [rad] about
v, as MuJoCo integrates the velocity of a ball joint.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

TINY = 1e-12
TINY_SQUARE = 1e-18
"""Added to squared lengths: it does not change that of a unit quaternion, and its square fits in float32."""
ROTATION_SIZE = 6
"""Number of numbers in `rotation_columns`."""


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


def rotation_columns(w: Any, x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """The first two columns of the rotation matrix, one after the other: six numbers.

    They determine the rotation, change continuously with it, and are the same for q, -q and any multiple of q
    (Zhou et al. 2019, On the continuity of rotation representations). A zero quaternion is the identity.

    Args:
        w: the real part: a number or an array of any library, because only arithmetic is used.
        x: the first imaginary part.
        y: the second imaginary part.
        z: the third imaginary part.
    """
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    square = ww + xx + yy + zz + TINY_SQUARE
    xy, xz, yz = (x * y + w * z) / square, (x * z - w * y) / square, (y * z + w * x) / square
    yx = (x * y - w * z) / square
    return (
        (ww + xx - yy - zz + TINY_SQUARE) / square,
        xy + xy,
        xz + xz,
        yx + yx,
        (ww - xx + yy - zz + TINY_SQUARE) / square,
        yz + yz,
    )


def from_rotation_columns(columns: Float[np.ndarray, "*batch 6"]) -> Float[np.ndarray, "*batch 4"]:
    """The quaternion, with w >= 0, of the rotation whose first two columns are nearest to these.

    The columns need not be orthogonal or of length one. The inverse of `rotation_columns`.
    """
    a = _unit(columns[..., :3], np.array([1.0, 0.0, 0.0]))
    b = columns[..., 3:] - a * np.sum(a * columns[..., 3:], axis=-1, keepdims=True)
    axis = np.eye(3)[np.argmin(np.abs(a), axis=-1)]  # at a right angle to `a` if the columns are parallel
    b = _unit(b, _unit(axis - a * np.sum(a * axis, axis=-1, keepdims=True), np.array([0.0, 1.0, 0.0])))
    c = np.cross(a, b)
    (r11, r21, r31), (r12, r22, r32), (r13, r23, r33) = (np.moveaxis(v, -1, 0) for v in (a, b, c))
    products = np.stack(  # 4 q q^T: each row is a multiple of q
        [
            np.stack([1 + r11 + r22 + r33, r32 - r23, r13 - r31, r21 - r12], axis=-1),
            np.stack([r32 - r23, 1 + r11 - r22 - r33, r12 + r21, r13 + r31], axis=-1),
            np.stack([r13 - r31, r12 + r21, 1 - r11 + r22 - r33, r23 + r32], axis=-1),
            np.stack([r21 - r12, r13 + r31, r23 + r32, 1 - r11 - r22 + r33], axis=-1),
        ],
        axis=-2,
    )
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return nearest_sign(normalise(row))


def _unit(v: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Scale to length one; a vector without a length becomes `otherwise`."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(length > TINY, v / np.maximum(length, TINY), otherwise)
