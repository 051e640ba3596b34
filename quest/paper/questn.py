"""QuEst for seven and more matches, planes included.

QuEst 7 (:mod:`quest.paper.quest7`) needs A to be of rank 31 and fails on planes, where A has rank 20 for any number
of matches. QuEst 6 uses only the 15 dimensions of A with the smallest singular values. They contain the monomials of
every true rotation, for general points and for planes. This solver does the same for any number of matches.

The number of equations is bounded. The quartic of a triple is linear in each of the three matrices ``n m'`` of its
matches (see :func:`quest.paper.monomials.rows_of_moments`) and changes sign where two matches are exchanged. Let Z be
the N x 9 matrix of those matrices as rows, and ``Z = Q S`` its QR decomposition. The triples of the N matches are then
the triples of the rows of S, at most nine, mixed by a matrix of orthonormal columns (the third compound matrix of Q),
so that ::

    |A quartics(q)| = |A_S quartics(q)|     for all q,

where A has N (N - 1) (N - 2) / 6 rows and A_S at most 84. The two sums are equal, and only the time of the QR
decomposition grows with N.

The null space is spanned by the 15 right singular vectors of A_S with the smallest singular values. The candidates
follow from it as in :mod:`quest.paper.quest6_fast`. For general points only four of these dimensions are null (three
from eight matches on); the others, which planes need, add noise. So the four smallest dimensions alone are used too:
this is QuEst 7 as an eigenproblem of the null space. Gauss-Newton on the Sampson errors of all matches removes the
remaining error of the candidates near a solution.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.geometry.quaternion import conjugate, multiply
from quest.paper.monomials import rows_of_moments
from quest.paper.newton import polish_on_matches
from quest.paper.quest6 import PRE_ROTATION, TIMES, as_batch, with_rotation_alone
from quest.paper.quest6_fast import DIRECTION, candidates_from_basis, candidates_from_null_space

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# The QR decomposition of orthonormal columns has a pivot this small only where the null space contains a quartic
# without w, that is, where a solution has w' = 0; see quest.paper.quest6 for the number.
_SINGULAR = 1e-11

# Noise of 0.5 px leaves an error of .03 rad. Gauss-Newton then needs three or four steps, and some more where the
# direction of the translation is weak.
_POLISHING_STEPS = 6


def questn(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 that fit seven or more matches, planes included.

    Parameters
    ----------
    m, n : (N, 3) or (B, N, 3) float
        Bearings in camera 1 and camera 2, of any norm, N >= 7, without outliers.

    Returns
    -------
    (K, 4) or (B, 16, 4) float
        Unit quaternions wxyz, canonical in sign; K <= 16. One sample: only the candidates. A batch: padded with NaN.
        The true rotation is among false ones: :func:`quest.paper.selection.select_candidates` ranks them.

    Raises
    ------
    InputError
        If the shapes do not fit, N < 7, a number is not finite, or a ray is zero.

    References
    ----------
    [F17] Fathian et al., arXiv:1704.02672, for the quartics. The remainder is not in the paper, see the module
    docstring.
    """
    m, n, single = as_batch(m, n, 7)
    moments = (n[..., :, None] * m[..., None, :]).reshape(*m.shape[:2], 9)
    S = np.asarray(np.linalg.qr(moments, mode="r")).reshape(len(m), -1, 3, 3)
    q = multiply(conjugate(PRE_ROTATION), _candidates(rows_of_moments(S, PRE_ROTATION)))
    return with_rotation_alone(polish_on_matches(q, m, n, _POLISHING_STEPS), m, n, single)


def _candidates(A: Floats) -> Floats:
    """Rotations (B, 16, 4) of the smallest singular values of A (B, T, 35), NaN-padded."""
    N = np.linalg.svd(np.linalg.qr(A, mode="r"))[2].swapaxes(-1, -2)
    C, K, regular = _normalized(N[..., 20:])
    planes_too = np.where(regular, candidates_from_null_space(C, K), np.nan)
    _, K, regular = _normalized(N[..., 31:])
    x1_times = np.tensordot(DIRECTION, K[:, TIMES[1:]], axes=(0, 1))
    general = np.where(regular, candidates_from_basis(K[:, :20], x1_times), np.nan)
    return np.concatenate([planes_too, general], axis=1)


def _normalized(N: Floats) -> tuple[Floats, Floats, Bools]:
    """A basis N (B, 35, D) of quartic monomials, changed so that its first 20 rows are orthonormal columns.

    Shapes: returns ``C`` (B, 20 - D, 20), returns ``K`` (B, 35, D), returns ``regular`` (B, 1, 1).

    * Returns ``regular``: Whether there is such a basis; C and K mean nothing elsewhere.
    """
    D = N.shape[-1]
    Q, R = np.linalg.qr(N[:, :20], mode="complete")
    R = R[:, :D]
    regular = (np.abs(np.diagonal(R, axis1=-2, axis2=-1)).min(axis=-1) > _SINGULAR)[:, None, None]
    R = np.where(regular, R, np.eye(D))
    x2 = np.linalg.solve(R.swapaxes(-1, -2), N[:, 20:].swapaxes(-1, -2)).swapaxes(-1, -2)
    return Q[..., D:].swapaxes(-1, -2), np.concatenate([Q[..., :D], x2], axis=1), regular
