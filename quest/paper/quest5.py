"""QuEst 5: the relative rotation from five matches, the smallest sample that determines it.

Five matches have ten triples, hence ten quartics ``A x = 0`` (see :mod:`quest.paper.monomials`). These are too few
for the 35 monomials. Multiplied by w, x, y and z they become 40 quintics in the 56 quintic monomials. The rank of the
quintics is 36, and their null space has 20 dimensions: one for each of the ten essential matrices that five matches
allow [1]_ and each of the two rotations of an essential matrix.

Let x1 be the 35 monomials that contain w (w times the quartics) and x2 the 21 other ones. The 30 quintics from x, y and
z are ``A1 x1 + A2 x2 = 0`` with A2 of rank 21. So nine combinations of them are free of x2. Together with the ten
quintics from w they are 19 equations of rank 15 in x1 alone, ``C x1 = 0``. With N1 an orthonormal basis of the null
space of C, ``x1 = N1 y`` and ``x2 = -pinv(A2) A1 N1 y``. Multiplication by ``lambda = (a . q) / w`` turns the entries
of x1 into other monomials, so that ::

    lambda y = (N1' T_a) y

with T_a the rows of these monomials on the basis. This is an eigenproblem of size 20. q follows from its eigenvectors
as in :mod:`quest.paper.quest6`, with the same ``q' = p q``.

References
----------
.. [F18] K. Fathian et al., "QuEst: A Quaternion-Based Approach for Camera Motion Estimation From Minimal Feature
   Points", IEEE Robotics and Automation Letters, 2018.
.. [1] D. Nister, "An efficient solution to the five-point relative pose problem", PAMI 2004.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.geometry.quaternion import canonical, conjugate, multiply
from quest.paper.monomials import QUARTICS, coefficient_rows
from quest.paper.quest6 import PRE_ROTATION, as_batch, regular_triangle, with_rotation_alone
from quest.paper.quest6_fast import DIRECTION, candidates_from_basis

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# The 56 quintic monomials in lexicographic order, of which the first 35 are w times QUARTICS.
_QUINTICS = tuple(combinations_with_replacement(range(4), 5))
_POSITION: dict[tuple[int, ...], int] = {letters: k for k, letters in enumerate(_QUINTICS)}


def _index(*letters: int) -> int:
    return _POSITION[tuple(sorted(letters))]


# For a letter a, the positions of a * QUARTICS among the quintics.
_TIMES: Ints = np.array([[_index(a, *letters) for letters in QUARTICS] for a in range(4)])

# For a pivot a, the positions of the monomials ``w a^3 (w, x, y, z)`` in x1.
_RATIOS: Ints = np.array([[_index(0, a, a, a, b) for b in range(4)] for a in range(4)])


def quest5(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 that five matches allow, by QuEst 5.

    Parameters
    ----------
    m, n : (5, 3) or (B, 5, 3) float
        Bearings in camera 1 and camera 2, of any norm.

    Returns
    -------
    (K, 4) or (B, 20, 4) float
        Unit quaternions wxyz, canonical in sign; K <= 20. One sample: only the candidates. A batch: padded with NaN.
        The real part of a complex pair is no solution of five matches. It is returned as by the other solvers of
        QuEst, since under noise a double solution becomes complex.

    Raises
    ------
    InputError
        If the shapes do not fit, the matches are not five, a number is not finite, or a ray is zero.

    References
    ----------
    [F18] Fathian et al., IEEE RA-L 2018, QuEst with five points. Departures: the null space by elimination, the
    direction of lambda, and ``q' = p q``.
    """
    m, n, single = as_batch(m, n, 5, exactly=True)
    K, regular = _null_space(coefficient_rows(m, n, PRE_ROTATION))
    shifted = np.tensordot(DIRECTION, K[:, _TIMES[1:]], axes=(0, 1))
    q = candidates_from_basis(K[:, :35], shifted, _RATIOS)
    q[~regular] = np.nan
    return with_rotation_alone(canonical(multiply(conjugate(PRE_ROTATION), q)), m, n, single)


def _null_space(A: Floats) -> tuple[Floats, Bools]:
    """Basis (B, 56, 20) of the quintic monomials that ten quartics A (B, 10, 35) allow, and where A2 is regular (B,).

    The first 35 rows, those of x1, are orthonormal columns.
    """
    products = np.zeros((len(A), 3, 10, 56))
    for letter in (1, 2, 3):
        products[:, letter - 1][..., _TIMES[letter]] = A
    quintics = products.reshape(len(A), 30, 56)
    Q, R = np.linalg.qr(quintics[..., 35:], mode="complete")
    R, regular = regular_triangle(R[:, :21])
    rotated = Q.swapaxes(-1, -2) @ quintics[..., :35]
    C = np.concatenate([A, rotated[:, 21:]], axis=1)
    x1 = np.linalg.svd(C)[2][:, 15:].swapaxes(-1, -2)
    x2 = -np.linalg.solve(R, rotated[:, :21] @ x1)
    return np.concatenate([x1, x2], axis=1), regular
