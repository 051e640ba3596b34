"""Unit quaternions and rotation matrices.

Hamilton convention, ordered ``wxyz``. ``q`` and ``-q`` are the same rotation; the one returned here has
``w >= 0``, and where w is zero its first non-zero entry is positive.

[F17] prints the rotation matrix with four signs exchanged (R13, R23, R31, R32); this is the correct one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "canonical",
    "conjugate",
    "matrix_from_quaternion",
    "multiply",
    "quaternion_from_matrix",
    "quaternion_from_vector",
    "rotation_angle",
    "rotation_from_vector",
]

Floats = NDArray[np.float64]


def matrix_from_quaternion(q: ArrayLike) -> Floats:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), which need not have unit norm."""
    a = np.asarray(q, float)
    w, x, y, z = np.moveaxis(a / np.linalg.norm(a, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_matrix(R: ArrayLike) -> Floats:
    """Unit quaternions (..., 4) of rotation matrices (..., 3, 3), canonical in sign.

    The four squared components are read off the diagonal and the largest is the pivot, so that nothing is
    divided by a small number whatever the angle (Shepperd 1978).
    """
    R = np.asarray(R, float)
    m00, m11, m22 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    # Row k is q scaled by 4 q_k: pick the row with the largest pivot.
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    d, e, f = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    rows = np.stack(
        [
            np.stack([1 + m00 + m11 + m22, a, b, c], axis=-1),
            np.stack([a, 1 + m00 - m11 - m22, d, e], axis=-1),
            np.stack([b, d, 1 - m00 + m11 - m22, f], axis=-1),
            np.stack([c, e, f, 1 - m00 - m11 + m22], axis=-1),
        ],
        axis=-2,
    )
    pivot = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(rows, pivot[..., None, None], axis=-2)[..., 0, :]
    return canonical(q / np.linalg.norm(q, axis=-1, keepdims=True))


def canonical(q: ArrayLike) -> Floats:
    """The same rotations with ``w >= 0`` (where w = 0: first non-zero entry positive)."""
    a = np.asarray(q, float)
    # The sign of the first non-zero entry; NaN rows pass through.
    first = np.argmax(a != 0, axis=-1)
    sign = np.sign(np.take_along_axis(a, first[..., None], axis=-1))
    return np.asarray(a * np.where(sign < 0, -1.0, 1.0))


def conjugate(q: ArrayLike) -> Floats:
    """The inverse rotation of a unit quaternion."""
    return np.asarray(np.asarray(q, float) * np.array([1.0, -1.0, -1.0, -1.0]))


def multiply(p: ArrayLike, q: ArrayLike) -> Floats:
    """Hamilton product: ``R(p q) = R(p) R(q)``."""
    pw, px, py, pz = np.moveaxis(np.asarray(p, float), -1, 0)
    qw, qx, qy, qz = np.moveaxis(np.asarray(q, float), -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def rotation_angle(R: ArrayLike) -> Floats:
    """Rotation angles in radians, [0, pi], of matrices (..., 3, 3); accurate near 0 and near pi."""
    q = quaternion_from_matrix(R)
    return np.asarray(2 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), q[..., 0]))


def quaternion_from_vector(w: ArrayLike) -> Floats:
    """Unit quaternions (..., 4) of rotation vectors (..., 3) in radians (the exponential map)."""
    w = np.asarray(w, float)
    angle = np.linalg.norm(w, axis=-1, keepdims=True)
    # sinc keeps the half-angle formula exact through zero.
    vector = 0.5 * np.sinc(angle / (2 * np.pi)) * w
    return np.concatenate([np.cos(angle / 2), vector], axis=-1)


def rotation_from_vector(w: ArrayLike) -> Floats:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) in radians (the exponential map)."""
    return matrix_from_quaternion(quaternion_from_vector(w))
