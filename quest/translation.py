"""Translation and depths of given rotations.

[F17] stacks ``u_i R m_i + t - v_i n_i = 0`` of all matches into a matrix C of 3 N rows and takes its null
vector (t, u, v). Each match takes part in its own three rows only, so its two depths are eliminated by
hand: multiplying by ``c_i = R m_i x n_i`` leaves ``c_i . t = 0``, hence t is the null vector of the 3x3
matrix ``sum c_i c_i^T``, and each pair of depths solves a 2x2 system.

On exact data this is the null vector of C. On noisy data it differs: the smallest singular vector of C
would weigh depths against translation, where this minimizes the epipolar residual, of which each match has
as much as it has parallax.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.epipolar import as_matches, depths_from_pose
from quest.errors import InputError, as_floats
from quest.quaternion import matrix_from_quaternion

__all__ = ["epipolar_normals", "translation_and_depths"]

Floats = NDArray[np.float64]

#: A parallax in radians under which there is no translation: a thousandth of a pixel of a camera of 1000 px.
_NO_PARALLAX_RAD = 1e-6


def epipolar_normals(R: Floats, m: Floats, n: Floats) -> Floats:
    """Normals ``R m x n`` (..., N, 3) of the epipolar planes, as long as the sine of the parallax."""
    return np.asarray(np.cross(m @ R.swapaxes(-1, -2), n))


def translation_and_depths(q: ArrayLike, m: ArrayLike, n: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Translations and depths that go with rotations: ``u R m + t = v n``, in one common scale.

    Parameters
    ----------
    q : (4,) or (K, 4) float
        Quaternions wxyz of cam2_from_cam1, of any norm but zero. Rows of NaN, as solvers pad with, are
        passed on.
    m, n : (N, 3) float
        Bearings in camera 1 and camera 2, N >= 2. The depths are along rays of unit norm, whatever norm is
        given.

    Returns
    -------
    t : (3,) or (K, 3) float
        Translation of norm 1, of the sign that puts most depths in front.
    u, v : (N,) or (K, N) float
        Depths in camera 1 and camera 2 in units of the translation; negative for a point behind, infinite
        or NaN for a match without parallax. Where no match has a parallax of 1e-6 rad, the camera has only
        turned: t is 0 and all depths are 1, one solution among as many as there are matches. Noise makes
        parallax: that t is not zero says nothing about whether the camera moved.

    Raises
    ------
    InputError
        Where the shapes do not fit, N < 2, or a bearing is zero or not finite.

    References
    ----------
    [F17] Fathian et al., arXiv:1704.02672, the matrix C; its null vector in closed form, see the module
    docstring.
    """
    m, n = as_matches(m, n, at_least=2)
    q = as_floats(q, "q")
    if m.ndim != 2 or q.ndim not in (1, 2) or q.shape[-1] != 4:
        raise InputError(f"q of shape {q.shape} for bearings of shape {m.shape}: give (4,) or (K, 4), and (N, 3)")
    known = np.asarray(np.isfinite(q).all(axis=-1))
    R = matrix_from_quaternion(np.where(known[..., None], q, [1.0, 0.0, 0.0, 0.0]))
    normals = epipolar_normals(R, m, n)
    t = np.linalg.eigh(normals.swapaxes(-1, -2) @ normals)[1][..., 0]
    u, v = depths_from_pose(R, t, m, n)
    in_front = np.sign(u) + np.sign(v)
    sign = np.where(np.nansum(in_front, axis=-1) < 0, -1.0, 1.0)[..., None]
    t, u, v = sign * t, sign * u, sign * v
    moved = (np.linalg.norm(normals, axis=-1).max(axis=-1) > _NO_PARALLAX_RAD)[..., None]
    t, u, v = np.where(moved, t, 0.0), np.where(moved, u, 1.0), np.where(moved, v, 1.0)
    t, u, v = (np.where(known[..., None], a, np.nan) for a in (t, u, v))
    return t, u, v
