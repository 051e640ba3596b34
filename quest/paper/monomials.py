"""The quartic equation of three matches for the rotation, and the matrix A of [F17].

[F17] is K. Fathian, J. P. Ramirez-Paredes, E. A. Doucette, J. W. Curtis, N. R. Gans, "Quaternion Based
Camera Pose Estimation From Matched Feature Points", arXiv:1704.02672.

Two views of a point obey ``u R m + t = v n``. The normal ``R m x n`` of its epipolar plane is orthogonal to
t, so the normals of three points i, j, k are coplanar::

    f_ijk(q) = det[R m_i x n_i, R m_j x n_j, R m_k x n_k] = 0

This is, up to sign, the determinant of the 6x6 matrix M that [F17] gets by eliminating t, u and v. R is quadratic in
q, so this is a form of degree six. It always has the factor ``|q|^2``; the other factor is a quartic in w, x, y, z with
35 monomials. The quartic follows without symbolic algebra: subtract the equations of points i and j, and multiply by
``R m_j x n_j``, which removes u_j and v_j::

    u_i N_ij = - v_i D_ij,      N_ij = n_j . R (m_i x m_j),      D_ij = (R m_j) . (n_i x n_j)

The same with k in place of j eliminates the depths of i and gives the quartic ``N_ij D_ik - D_ij N_ik``, made of
quadratics. The quartic is evaluated at 35 fixed unit quaternions and interpolated by the inverse of their matrix of
monomials. A whole batch of samples takes two matrix products.

Departure from [F17]: the paper expands the coefficients symbolically. The expansion printed in its Example 2 is not
that of its points, not even up to scale.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.geometry.quaternion import matrix_from_quaternion, multiply

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: The 35 quartic monomials, each as its four letters (0 = w, 1 = x, 2 = y, 3 = z), in lexicographic order.
#: The first 20 contain w, the first 4 contain w^3: the vectors x1 of QuEst 6 and QuEst 7.
QUARTICS: tuple[tuple[int, ...], ...] = tuple(combinations_with_replacement(range(4), 4))

_POSITION = {letters: k for k, letters in enumerate(QUARTICS)}

# The best of 3000 seeds: its 35 unit quaternions have the condition number 102, the median over the seeds is 930.
_NODE_SEED = 1001


def quartic_index(*letters: int) -> int:
    """Position of a monomial in :data:`QUARTICS`."""
    return _POSITION[tuple(sorted(letters))]


def quartics(q: ArrayLike) -> Floats:
    """The 35 quartic monomials of quaternions.

    Shapes: ``q`` (..., 4), returns (..., 35).
    """
    return np.asarray(np.asarray(q, float)[..., np.array(QUARTICS)].prod(axis=-1))


@cache
def triples(n: int) -> Ints:
    """All index triples i < j < k.

    Shapes: returns (T, 3).
    """
    return np.array(list(combinations(range(n), 3)), dtype=np.int64)


@cache
def _interpolation(before: tuple[float, ...]) -> tuple[Floats, Floats]:
    """Rotations of the fixed quaternions, (9, 35), and the map (35, 35) from values there to coefficients."""
    nodes = np.random.default_rng(_NODE_SEED).normal(size=(35, 4))
    nodes /= np.linalg.norm(nodes, axis=1, keepdims=True)
    rotations = matrix_from_quaternion(nodes).reshape(35, 9).T
    coefficients_from_values = np.asarray(np.linalg.inv(quartics(multiply(before, nodes))).T, float)
    return np.ascontiguousarray(rotations), coefficients_from_values


@cache
def _pairs(n: int) -> tuple[Ints, Ints, Ints]:
    """Pairs i < j, (P, 2), and for every triple the positions of its pairs (i, j) and (i, k)."""
    pairs = list(combinations(range(n), 2))
    position = {pair: k for k, pair in enumerate(pairs)}
    ij = np.array([position[i, j] for i, j, _ in combinations(range(n), 3)], dtype=np.int64)
    ik = np.array([position[i, k] for i, _, k in combinations(range(n), 3)], dtype=np.int64)
    return np.array(pairs, dtype=np.int64), ij, ik


def coefficient_rows(m: Floats, n: Floats, before: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> Floats:
    """Matrix A of [F17]: one row of 35 coefficients for each triple of matches, ``A quartics(q) = 0``.

    Shapes: ``m, n`` (B, N, 3).

    * ``m, n``: Bearings of the matches in camera 1 and camera 2, of unit norm.
    * ``before``: Unit quaternion p. The coefficients are those of the unknown ``q' = p q`` instead of q, as if the
      second camera had been rotated by p. This takes no time, since the fixed quaternions are rotated once.
    * Returns: Rows in the order of :func:`triples`, columns in that of :data:`QUARTICS`.
    """
    rotations, coefficients_from_values = _interpolation(before)
    pairs, ij, ik = _pairs(m.shape[1])
    i, j = pairs.T
    mi, mj, ni, nj = m[:, i], m[:, j], n[:, i], n[:, j]
    # a . R b is linear in the outer product of a and b.
    outer_N = nj[..., :, None] * cross(mi, mj)[..., None, :]
    outer_D = cross(ni, nj)[..., :, None] * mj[..., None, :]
    shape = (len(m), len(pairs), 35)
    N = (outer_N.reshape(-1, 9) @ rotations).reshape(shape)
    D = (outer_D.reshape(-1, 9) @ rotations).reshape(shape)
    values = N[:, ij] * D[:, ik] - D[:, ij] * N[:, ik]
    rows = values.reshape(-1, 35) @ coefficients_from_values
    return rows.reshape(len(m), len(ij), 35)


def rows_of_moments(moments: Floats, before: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> Floats:
    """Rows as those of :func:`coefficient_rows`, for linear combinations of matches.

    The epipolar normal ``R m x n`` is linear in the matrix ``n m'``, and the quartic of three matches is linear in each
    of the three matrices. So the quartic is defined for any three matrices, not for matrices of rank one only.

    Shapes: ``moments`` (B, K, 3, 3).

    * Returns: Rows in the order of :func:`triples`, columns in that of :data:`QUARTICS`.
    """
    rotations, coefficients_from_values = _interpolation(before)
    B, K = moments.shape[:2]
    R = rotations.T.reshape(35, 3, 3)
    products = np.einsum("gac,bkdc->bkgad", R, moments)  # sums of (R m) n'
    normals = np.stack(
        [
            products[..., 1, 2] - products[..., 2, 1],
            products[..., 2, 0] - products[..., 0, 2],
            products[..., 0, 1] - products[..., 1, 0],
        ],
        axis=-1,
    )
    i, j, k = triples(K).T
    values = (cross(normals[:, i], normals[:, j]) * normals[:, k]).sum(axis=-1)
    return np.asarray(values.reshape(-1, 35) @ coefficients_from_values).reshape(B, len(i), 35)


def cross(a: Floats, b: Floats) -> Floats:
    """Cross product over the last axis; a third of the time of ``np.cross`` on small batches."""
    return np.asarray(a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]])
