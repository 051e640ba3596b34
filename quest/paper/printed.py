"""QuEst 6, QuEst 7, translation and depths exactly as printed in [F17], as a reference.

The printed forms fail at rotations by 180 degrees, where w = 0, and lose accuracy under noise. The documentation of
:mod:`quest.paper.quest6` and :mod:`quest.paper.quest7` lists the departures of the public solvers. Both forms use
the corrected rotation matrix and quartics, since the printed ones describe no rotation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError, as_floats
from quest.geometry.epipolar import as_matches
from quest.geometry.quaternion import canonical, matrix_from_quaternion
from quest.paper.monomials import coefficient_rows, quartic_index
from quest.paper.quest6 import TIMES
from quest.paper.quest7 import cubed_eigenproblem

Floats = NDArray[np.float64]


def quest6_printed(m: ArrayLike, n: ArrayLike) -> Floats:
    """QuEst 6 with ``lambda = x / w`` and cube roots of w^3, x^3, y^3, z^3.

    [F17] Fathian et al., arXiv:1704.02672, QuEst with six points.

    Shapes: ``m, n`` (N, 3), returns (K, 4).

    * Returns: Unit quaternions wxyz of the real eigenvectors and of the real part of each complex pair.
    """
    m, n = as_matches(m, n, at_least=6)
    A = coefficient_rows(m[None], n[None])[0]
    powers = np.concatenate([np.eye(20), -np.linalg.pinv(A[:, 20:]) @ A[:, :20]])
    x1 = _real_eigenvectors(powers[TIMES[1]])
    cubes = x1[:, [quartic_index(0, a, a, a) for a in range(4)]]
    return _unit(np.cbrt(cubes))


def quest7_printed(m: ArrayLike, n: ArrayLike) -> Floats:
    """QuEst 7 with ``lambda = x^3 / w^3``.

    [F17] Fathian et al., arXiv:1704.02672, QuEst with seven points.

    Shapes: ``m, n`` (N, 3), returns (K, 4).

    * Returns: Unit quaternions wxyz of the real eigenvectors and of the real part of each complex pair.
    """
    m, n = as_matches(m, n, at_least=7)
    (B,), _ = cubed_eigenproblem(coefficient_rows(m[None], n[None]), "x")
    return _unit(_real_eigenvectors(B[0]))


def translation_and_depths_printed(q: ArrayLike, m: ArrayLike, n: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Translation and depths as the paper has them: the null vector of the matrix C. The time grows with N^3.

    t and the depths share one scale, so that |t| tends to zero as the motion does, on exact matches: under one pixel of
    noise |t| / depth is .004 to .007 without any motion.

    Parameters
    ----------
    q : (4,) array_like
        Quaternion wxyz of cam2_from_cam1.
    m, n : (N, 3) array_like
        Bearings in camera 1 and camera 2, N >= 2.

    Returns
    -------
    t : (3,) float
        Translation; t, u and v together have unit norm.
    u, v : (N,) float
        Depths in the unit of t, along rays of unit norm. Most of them are positive.

    Raises
    ------
    InputError
        If the shapes do not fit, N < 2, a bearing is zero or not finite, or the quaternion is zero or not finite.

    References
    ----------
    .. [F17] K. Fathian et al., arXiv:1704.02672, 2017, the matrix C.
    """
    m, n = as_matches(m, n, at_least=2)
    q = as_floats(q, "q")
    if m.ndim != 2 or q.shape != (4,):
        raise InputError(f"q of shape {q.shape} for bearings of shape {m.shape}: give (4,) and (N, 3)")
    largest = np.abs(q).max()
    if not 0 < largest < np.inf:
        raise InputError("q is zero or not finite: give a quaternion of any other norm")
    count = len(m)
    C = np.zeros((count, 3, 3 + 2 * count))
    C[:, :, :3] = np.eye(3)
    match = np.arange(count)
    C[match, :, 3 + match] = m @ matrix_from_quaternion(q / largest).T
    C[match, :, 3 + count + match] = -n
    null = np.linalg.svd(C.reshape(3 * count, -1))[2][-1]
    null = null * (1.0 if np.sign(null[3:]).sum() >= 0 else -1.0)
    return null[:3], null[3 : 3 + count], null[3 + count :]


def _real_eigenvectors(B: Floats) -> Floats:
    """Eigenvectors of B as rows: the real ones, and the real part of one of each complex pair."""
    values, vectors = np.linalg.eig(B)
    return np.asarray(vectors[:, values.imag >= 0].real.T)


def _unit(q: Floats) -> Floats:
    """Quaternions (K, 4) of unit norm and canonical sign, without those of norm zero."""
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    some = norm[:, 0] > 0
    return canonical(q[some] / norm[some])
