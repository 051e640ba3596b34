"""QuEst 6, deflated: the same rotations from an eigenproblem of size 12 instead of 20, and fewer false ones.

The notation is that of :mod:`quest.paper.quest6`: x1 = w v are the 20 monomials that contain w, v the 20 cubic
monomials, and the 20 quartics of six matches are ``A1 x1 + A2 x2 = 0``. A2 has 20 rows and rank 15, so five
combinations of the rows are free of x2. They are quartics with the factor w, that is, cubics ::

    C v = 0,      C = Q2' A1,   Q2 the five left null vectors of A2,

and the other 15 give ``x2 = B' x1`` as before. Let B_l, 20x20, be the matrix of QuEst 6 that multiplies
x1 by l / w. QuEst 6 solves ``lambda x1 = B_x x1`` alone, as if the 20 entries of x1 were free, and finds
20 solutions. But a solution obeys the five cubics, and also their products with x, y and z, which are no
combinations of the 20 quartics ::

    C x1 = 0,     C B_x x1 = C B_y x1 = C B_z x1 = 0

Of these 20 equations 18 are independent for general points. Two solutions remain: the two rotations of the twisted
pair. For points on a plane 8 equations are independent, and 12 solutions remain. With V an orthonormal basis of the 12
dimensions in which the equations are fulfilled best, x1 = V y and ::

    lambda y = (V' B_a V) y,      B_a = a_x B_x + a_y B_y + a_z B_z,   lambda = (a . q) / w

is the problem of size 12. It is exact for general points and for planes: V then contains all true x1, and V V' changes
none of them. As in :mod:`quest.paper.quest6`, q follows from ``x1 = V y`` by ratios of monomials, the unknown is
``q' = p q``, so that rotations by 180 degrees are no special case, and the real part of a complex pair is a candidate.

What was tried (100 to 200 problems of ``tests/benchmarks/quest/paper_protocol.py`` a level; mean error of the first
ranked)

* 8 dimensions in place of 12 are no better on general points (.030 against .034 at 0.5 px, .080 against .071 at 2 px)
  and wrong on exact planes, where 12 solutions exist; 15, without the products, take longer and rank worse (.045).
* The null space in all 35 monomials, isotropic in q by weights of the square roots of the multinomial
  coefficients, in place of x1: not better (.036), and slower, since B_a is then no longer at hand.
* The 12 dimensions by pivoted Gram-Schmidt or subspace iteration in place of the eigen-decomposition: as accurate, a
  sixth of the time less, and six more lines.
* Gauss-Newton on ``|A x(q)|^2`` afterwards: exact data gain two digits, noisy data rank no better. Gauss-Newton on the
  Sampson errors of the sample improves both, see ``polish``.
* No eigenproblem at all: the quartics at 300, 1000 and 3000 fixed rotations, and Gauss-Newton from the 12 lowest local
  minima. The basins of attraction are too narrow: even 3000 rotations, which take five times as long as this solver,
  miss the solution of exact data in half of the problems.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import as_index
from quest.geometry.quaternion import conjugate, multiply
from quest.paper.monomials import coefficient_rows
from quest.paper.newton import polish_on_matches
from quest.paper.quest6 import (
    PRE_ROTATION,
    RATIOS,
    TIMES,
    as_batch,
    quaternions_from_monomials,
    regular_triangle,
    with_rotation_alone,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Number of solutions for points on a plane: complex ones, and both motions of the plane with their twisted pairs.
#: General points have two solutions. No smaller number of dimensions is exact for both.
LARGEST_NUMBER = 12

#: The direction a, of no particular orientation, so that no two rotations have the same lambda by symmetry.
DIRECTION = np.array([0.602, -0.501, 0.622])


def quest6_fast(m: ArrayLike, n: ArrayLike, polish: int = 1) -> Floats:
    """Rotations cam2_from_cam1 that six matches allow, by QuEst 6 in 12 dimensions.

    Parameters
    ----------
    m, n : (6, 3) or (B, 6, 3) float
        Bearings in camera 1 and camera 2, of any norm.
    polish : int
        Number of Gauss-Newton steps on the Sampson errors of the sample. One step takes exact data to rounding and
        lowers the median error of the first ranked candidate under noise of 0.5 px by a third, for a third more time.

    Returns
    -------
    (K, 4) or (B, 12, 4) float
        Unit quaternions wxyz, canonical in sign; K <= 12. One sample: only the candidates. A batch: padded with NaN,
        only NaN for a sample that determines no rotation. Where all matches agree on a rotation without translation,
        this rotation is the only candidate.

    Raises
    ------
    InputError
        If the shapes do not fit, the matches are not six, a number is not finite, a ray is zero, or polish is no
        number of steps.

    References
    ----------
    [F17] Fathian et al., arXiv:1704.02672, QuEst with six points. The deflation is not in the paper, see the module
    docstring.
    """
    steps = as_index(polish, "polish", at_least=0)
    m, n, single = as_batch(m, n, 6, exactly=True)
    C, K, regular = _null_space(coefficient_rows(m, n, PRE_ROTATION))
    q = multiply(conjugate(PRE_ROTATION), candidates_from_null_space(C, K))
    q[~regular] = np.nan
    return with_rotation_alone(polish_on_matches(q, m, n, steps), m, n, single)


def _null_space(A: Floats) -> tuple[Floats, Floats, Bools]:
    """The cubics and the quartic monomials that six matches allow, from their rows A (B, 20, 35).

    Shapes: returns ``C`` (B, 5, 20), returns ``K`` (B, 35, 15), returns ``regular`` (B,).

    * Returns ``K``: Basis of the null space of A; the first 20 rows are orthonormal columns.
    """
    Q, R = np.linalg.qr(A[..., 20:], mode="complete")
    R, regular = regular_triangle(R[:, :15])
    rotated = Q.swapaxes(-1, -2) @ A[..., :20]
    basis = np.linalg.qr(rotated[:, 15:].swapaxes(-1, -2), mode="complete")[0]
    x1 = basis[..., 5:]
    x2 = -np.linalg.solve(R, rotated[:, :15] @ x1)
    return basis[..., :5].swapaxes(-1, -2), np.concatenate([x1, x2], axis=1), regular


def candidates_from_null_space(C: Floats, K: Floats) -> Floats:
    """Rotations whose quartic monomials lie best in a null space.

    Shapes: ``C`` (B, 5, 20), ``K`` (B, 35, 15), returns (B, 12, 4).

    * ``K``: Basis of the null space; the first 20 rows are orthonormal columns, orthogonal to C.
    """
    shifted = K[:, TIMES[1:]]  # B_l x1 on the basis: (B, 3, 20, 15)
    products = (C[:, None] @ shifted).reshape(len(K), 15, 15)
    V = np.linalg.eigh(products.swapaxes(-1, -2) @ products)[1][..., :LARGEST_NUMBER]
    x1 = K[:, :20] @ V
    B_a = np.tensordot(DIRECTION, shifted, axes=(0, 1)) @ V
    return candidates_from_basis(x1, B_a)


def candidates_from_basis(x1: Floats, x1_times: Floats, ratios: Ints = RATIOS) -> Floats:
    """Rotations whose monomials x1 lie in a space of D dimensions.

    Shapes: ``x1`` (B, X, D), ``x1_times`` (B, X, D), ``ratios`` (4, 4), returns (B, D, 4).
    """
    values, vectors = np.linalg.eig(x1.swapaxes(-1, -2) @ x1_times)
    q = quaternions_from_monomials((x1 @ vectors).swapaxes(-1, -2), ratios)
    return np.where((values.imag >= 0)[..., None], q, np.nan)
