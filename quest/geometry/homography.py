"""Planes: the homography that a plane induces between bearings, and the two poses that explain it.

A plane with ``k . X = 1`` in camera 1 turns ``u R m + t = v n`` into ``n ~ (R + t k^T) m``. The inverse depth of a
point on the plane is linear in its bearing, ``1/u = k . m``. Two sets of R, t (up to scale) and k with points in front
of both cameras belong to one homography H [1]_. The second pose is called the second motion of the plane here.

References
----------
.. [1] Y. Ma, S. Soatto, J. Kosecka, S. Sastry, "An Invitation to 3-D Vision", 2004, section 5.3.3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# A matrix whose second singular value is this small relative to the first maps all rays to a line.
_SINGULAR = 1e-12


def homography_residuals(H: Floats, m: Floats, n: Floats) -> Floats:
    """Residuals of ``n ~ H m`` in units of the noise of one bearing.

    Each of the two tangent components is a sum of the noise of n and of m. For motions between video frames H is close
    to a rotation and both have the same weight, hence the division by sqrt(2).

    Shapes: ``H`` (3, 3), ``m, n`` (N, 3), returns (N, 3).
    """
    transferred = m @ H.T
    norm = np.linalg.norm(transferred, axis=1, keepdims=True)
    a = transferred / np.maximum(norm, 1e-300)
    d = a - n
    return np.asarray((d - np.einsum("ij,ij->i", d, n)[:, None] * n) / np.sqrt(2.0))


def decompose_homography(H: Floats, m: Floats) -> list[tuple[Floats, Floats, Floats]]:
    """Decompose a homography into its two poses and planes, ``H ~ R + t k^T`` [1]_.

    Shapes: ``H`` (3, 3), ``m`` (N, 3), returns (R, t, k).

    * ``m``: Unit bearings in camera 1. (R, -t, -k) gives the same homography; the sign is the one with most of these
      points in front of camera 1.
    * Returns: R (3, 3), t (3,) and k (3,) of each pose: t in units of the distance of the plane from camera 1, k of
      unit norm. Empty where H is a rotation, has a rank below two, or is not finite.
    """
    if not np.isfinite(H).all():
        return []
    _, S, (v1, v2, v3) = np.linalg.svd(H)
    if not S[1] > _SINGULAR * S[0]:
        return []
    H = H / S[1]
    if H[0] @ _cross(H[1], H[2]) < 0:  # the determinant
        H = -H
    s1, s3 = (S[0] / S[1]) ** 2, (S[2] / S[1]) ** 2
    if s1 - s3 < 1e-12:
        return []
    solutions = []
    spread1, spread3 = np.sqrt(max(1 - s3, 0.0)), np.sqrt(max(s1 - 1, 0.0))
    for sign in (1.0, -1.0):
        u = (spread1 * v1 + sign * spread3 * v3) / np.sqrt(s1 - s3)
        Hv, Hu = H @ v2, H @ u
        k = _cross(v2, u)
        frame1, frame2 = np.array([v2, u, k]), np.array([Hv, Hu, _cross(Hv, Hu)])
        R = frame2.T @ frame1
        # R is a rotation up to rounding errors of 1e-10 at most: a step of Newton's method leads to the nearest one.
        R = 1.5 * R - 0.5 * (R @ R.T @ R)
        t = (H - R) @ k
        if 2 * np.count_nonzero(m @ k < 0) > len(m):
            k, t = -k, -t
        solutions.append((R, t, k))
    return solutions


def _cross(a: Floats, b: Floats) -> Floats:
    """``a x b`` of two vectors (3,); numpy takes 20 us for it."""
    a0, a1, a2 = a.tolist()
    b0, b1, b2 = b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
