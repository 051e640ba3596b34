"""Unit quaternions and rotation matrices.

Hamilton convention, ordered ``wxyz``. ``q`` and ``-q`` are the same rotation; the functions here return the one with
``w >= 0``, and where w is zero the one whose first non-zero entry is positive (the canonical sign).

[F17] prints the rotation matrix with four wrong signs (R13, R23, R31, R32); the matrix here has the correct ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError

Floats = NDArray[np.float64]


def matrix_from_quaternion(q: ArrayLike) -> Floats:
    """Rotation matrices of quaternions.

    Shapes: ``q`` (..., 4), returns (..., 3, 3).

    * ``q``: Quaternions wxyz, of any norm but zero. Rows of NaN, the padding of solvers, give NaN.
    """
    a = np.asarray(q, float)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(a, axis=-1, keepdims=True)
    if not ((norm > 1e-100) & (norm < 1e100)).all():  # squares of such numbers overflow or vanish
        a, norm = _scaled(a)
    w, x, y, z = np.moveaxis(a / norm, -1, 0)
    return _matrix(
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    )


def _matrix(*rows: list[Floats]) -> Floats:
    """Matrices (..., K, K) from their entries (...)."""
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _scaled(q: Floats) -> tuple[Floats, Floats]:
    """The same rotations with a largest component of 1, and the norms (..., 1); rows of NaN stay."""
    largest = np.abs(q).max(axis=-1, keepdims=True)
    if not ((largest > 0) & (largest < np.inf) | np.isnan(largest)).all():
        raise InputError("a quaternion is zero or infinite: it is no rotation")
    q = q / largest
    return q, np.linalg.norm(q, axis=-1, keepdims=True)


def quaternion_from_matrix(R: ArrayLike) -> Floats:
    """Unit quaternions of rotation matrices.

    The diagonal gives the four squared components. The largest is the pivot, so that there is no division by a small
    number at any angle.

    S. W. Shepperd, "Quaternion from rotation matrix", Journal of Guidance and Control 1, 1978.

    Shapes: ``R`` (..., 3, 3), returns (..., 4).
    """
    R = np.asarray(R, float)
    m00, m11, m22 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    # Row k is q scaled by 4 q_k: pick the row with the largest pivot.
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    d, e, f = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    rows = _matrix(
        [1 + m00 + m11 + m22, a, b, c],
        [a, 1 + m00 - m11 - m22, d, e],
        [b, d, 1 - m00 + m11 - m22, f],
        [c, e, f, 1 - m00 - m11 + m22],
    )
    pivot = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(rows, pivot[..., None, None], axis=-2)[..., 0, :]
    # The four pivots add up to 4, so that the norm is at least 1.
    return canonical(q / np.linalg.norm(q, axis=-1, keepdims=True))


def canonical(q: ArrayLike) -> Floats:
    """The same rotations with ``w >= 0`` (where w = 0: first non-zero entry positive).

    Shapes: ``q`` (..., 4), returns (..., 4).
    """
    a = np.asarray(q, float)
    # The sign of the first non-zero entry.
    first = np.argmax(a != 0, axis=-1)
    sign = np.sign(np.take_along_axis(a, first[..., None], axis=-1))
    return np.asarray(a * np.where(sign < 0, -1.0, 1.0))


def conjugate(q: ArrayLike) -> Floats:
    """The inverse rotations of unit quaternions.

    Shapes: ``q`` (..., 4), returns (..., 4).
    """
    return np.asarray(np.asarray(q, float) * np.array([1.0, -1.0, -1.0, -1.0]))


def multiply(p: ArrayLike, q: ArrayLike) -> Floats:
    """Hamilton product: ``R(p q) = R(p) R(q)``.

    Shapes: ``p, q`` (..., 4), returns (..., 4).
    """
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
    """Rotation angles of matrices, accurate near 0 and near pi.

    Shapes: ``R`` (..., 3, 3).
    """
    R = np.asarray(R, float)
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    # Twice the sine and twice the cosine.
    return np.asarray(np.arctan2(np.sqrt(a * a + b * b + c * c), R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1))


def quaternion_from_vector(w: ArrayLike) -> Floats:
    """Unit quaternions of rotation vectors (the exponential map).

    Shapes: ``w`` (..., 3), returns (..., 4).
    """
    w = np.asarray(w, float)
    angle = np.linalg.norm(w, axis=-1, keepdims=True)
    # With sinc the half-angle formula is exact at zero too.
    vector = 0.5 * np.sinc(angle / (2 * np.pi)) * w
    return np.concatenate([np.cos(angle / 2), vector], axis=-1)


def vector_from_rotation(R: ArrayLike) -> Floats:
    """Rotation vectors of rotation matrices (the logarithm), of angles up to pi.

    Shapes: ``R`` (..., 3, 3), returns (..., 3).
    """
    q = canonical(quaternion_from_matrix(R))
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    return np.asarray(q[..., 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0))


def rotation_from_vector(w: ArrayLike) -> Floats:
    """Rotation matrices of rotation vectors (the exponential map).

    Shapes: ``w`` (..., 3), returns (..., 3, 3).
    """
    return matrix_from_quaternion(quaternion_from_vector(w))
