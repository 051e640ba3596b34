"""Translation and depths of given rotations.

[F17] stacks ``u_i R m_i + t - v_i n_i = 0`` of all matches into a matrix C of 3 N rows and takes its null vector
(t, u, v). The two depths of a match appear in three rows only, so they can be eliminated: multiplication by
``c_i = a_i x n_i``, with ``a_i = R m_i``, gives ``c_i . t = 0``, and t is the null vector of the 3x3 matrix
``M = sum c_i c_i^T``. On exact data this is the null vector of C, for N of any size.

Under noise the estimates differ. ``c_i . t`` has the variance ``sigma^2 t^T N_i t``,
``N_i = 2 I - a_i a_i^T - n_i n_i^T`` (from the gradient of the residual with respect to both rays). The variance
vanishes where t lies along the rays, so the eigenvector of M is biased towards the rays. Therefore the quotient
``t^T M t / t^T N t`` is minimized, N the sum of N_i; its noise is the same in all directions. This is a generalized
eigenproblem of 3x3 matrices (Taubin's method for conics). It is solved twice, the second time with the weight
``1 / t^T N_i t`` for each match, so that the numerator is the sum of squared Sampson errors. With true rotations, a
baseline of 0.05 of the distance, 2 px of noise at a focal length of 800 px and 100 matches, the mean error of the
direction is 1.7 degrees; that of the null vector of C is 2.0 degrees, that of the eigenvector of M 4.1 degrees. With a
baseline of a third of the distance the three are equal.

The depth u follows from the components orthogonal to the other ray, ``u = |t_n|^2 / -(a . t_n)`` with t_n the part of t
orthogonal to n; v follows in the same way. So only the displacement along the epipolar line has influence. The midpoint
of the common perpendicular counts the displacement across the line as parallax too, and its depths are 1.4 % too short
in the example above.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError, as_floats
from quest.geometry.epipolar import as_matches
from quest.geometry.quaternion import matrix_from_quaternion

Floats = NDArray[np.float64]

#: Number of solutions of the eigenproblem: one without weights, one with the weights of the first solution.
_SOLUTIONS = 2
#: Smallest variance relative to the largest: for rays within 1e-5 rad of one direction, t along it would fit anything.
_LEAST_VARIANCE = 1e-10
#: A parallax in radians under which there is no translation: a thousandth of a pixel of a camera of 1000 px.
_NO_PARALLAX_RAD = 1e-6


def epipolar_normals(R: Floats, m: Floats, n: Floats) -> Floats:
    """Normals ``R m x n`` of the epipolar planes.

    Shapes: ``R`` (..., 3, 3), ``m, n`` (..., N, 3), returns (..., N, 3).
    """
    return np.asarray(np.cross(m @ R.swapaxes(-1, -2), n))


def translation_and_depths(q: ArrayLike, m: ArrayLike, n: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Translations and depths that go with rotations: ``u R m + t = v n``, in one common scale.

    Parameters
    ----------
    q : (4,) or (K, 4) float
        Quaternions wxyz of cam2_from_cam1, of any norm but zero. Rows of NaN (the padding of solvers) give NaN.
    m, n : (N, 3) float
        Bearings in camera 1 and camera 2, N >= 2. The depths are distances along the rays, whatever norm the rays have.

    Returns
    -------
    t : (3,) or (K, 3) float
        Translation of norm 1; the sign is the one with most positive depths.
    u, v : (N,) or (K, N) float
        Depths in camera 1 and camera 2 in units of the translation; negative for a point behind the camera, infinite
        or NaN for a match without parallax. Where no match has a parallax of 1e-6 rad, the camera has only rotated: t
        is 0 and all depths are 1, which is one of many solutions. Noise causes parallax, so a t that is not zero is no
        evidence of a translation; see :func:`quest.parallax_statement`.

    Raises
    ------
    InputError
        If the shapes do not fit, N < 2, a bearing is zero or not finite, or a quaternion is zero or infinite.

    References
    ----------
    [F17] Fathian et al., arXiv:1704.02672, the matrix C; G. Taubin, "Estimation of planar curves, surfaces and
    nonplanar space curves defined by implicit equations", PAMI 1991. Derived in the module docstring;
    :func:`quest.paper.printed.translation_and_depths_printed` takes the null vector of C.
    """
    m, n = as_matches(m, n, at_least=2)
    q = as_floats(q, "q")
    if m.ndim != 2 or q.ndim not in (1, 2) or q.shape[-1] != 4:
        raise InputError(f"q of shape {q.shape} for bearings of shape {m.shape}: give (4,) or (K, 4), and (N, 3)")
    largest = np.abs(q).max(axis=-1, keepdims=True)  # NaN where a row holds one
    if not largest.all() or np.isinf(q).any():
        raise InputError("q is zero or infinite: give quaternions of any other norm")
    known = ~np.isnan(largest[..., 0])
    # Scaled, so that no norm overflows or vanishes.
    R = matrix_from_quaternion(np.where(known[..., None], q / largest, [1.0, 0.0, 0.0, 0.0]))
    normals = epipolar_normals(R, m, n)
    a = m @ R.swapaxes(-1, -2)
    weight = np.ones(a.shape[:-1])
    for _ in range(_SOLUTIONS):
        t = _direction(normals, a, n, weight)
        p, s = (a @ t[..., None])[..., 0], t @ n.T
        weight = 1 / np.maximum(2 - p**2 - s**2, _LEAST_VARIANCE)
    u, v = _depths(p, s, np.einsum("...ij,ij->...i", a, n))
    in_front = np.sign(u) + np.sign(v)
    sign = np.where(np.nansum(in_front, axis=-1) < 0, -1.0, 1.0)[..., None]
    t, u, v = sign * t, sign * u, sign * v
    moved = (np.linalg.norm(normals, axis=-1).max(axis=-1) > _NO_PARALLAX_RAD)[..., None]
    t, u, v = np.where(moved, t, 0.0), np.where(moved, u, 1.0), np.where(moved, v, 1.0)
    t, u, v = (np.where(known[..., None], a, np.nan) for a in (t, u, v))
    return t, u, v


def _direction(normals: Floats, a: Floats, n: Floats, weight: Floats) -> Floats:
    """Minimum (..., 3) of ``t^T M t / t^T N t``, |t| = 1, of matches weighed by (..., N)."""
    w = weight[..., None]
    M = normals.swapaxes(-1, -2) @ (w * normals)
    N = 2 * weight.sum(axis=-1)[..., None, None] * np.eye(3) - a.swapaxes(-1, -2) @ (w * a) - n.T @ (w * n)
    values, vectors = np.linalg.eigh(N)
    values = np.maximum(values, _LEAST_VARIANCE * values[..., -1:])
    whitening = (vectors / np.sqrt(values)[..., None, :]) @ vectors.swapaxes(-1, -2)
    white = np.linalg.eigh(whitening @ M @ whitening)[1][..., :1]
    t = (whitening @ white)[..., 0]
    return np.asarray(t / np.linalg.norm(t, axis=-1, keepdims=True))


def _depths(p: Floats, s: Floats, c: Floats) -> tuple[Floats, Floats]:
    """Depths of matches from ``p = a . t``, ``s = n . t`` and ``c = a . n``."""
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel rays: infinite, along t: NaN
        return (1 - s * s) / (s * c - p), (1 - p * p) / (s - c * p)
