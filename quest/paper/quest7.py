"""QuEst 7: the relative rotation from seven matches that do not lie on a plane.

The notation is that of [F17] (see :mod:`quest.paper.monomials`). Seven matches have 35 triples, hence 35 quartics.
With x1 the four monomials ``w^3 (w, x, y, z)`` and x2 the other 31::

    A1 x1 + A2 x2 = 0      so      x2 = -pinv(A2) A1 x1

Multiplied by ``lambda = x^3 / w^3``, x1 turns into ``x^3 (w, x, y, z)``, four entries of x2. Their rows of
``-pinv(A2) A1`` are the matrix B of an eigenproblem of size 4 only, ``lambda x1 = B x1``, and its
eigenvectors are proportional to q. ``y^3 / w^3`` and ``z^3 / w^3`` give equally valid problems.

The solver needs A, 35x35, to have rank 31. Points on a plane give rank 20: the pseudo-inverse then selects a solution
of the monomials that belongs to no rotation, and the candidates are wrong, as [F17] states. For planes use
:func:`quest.paper.quest6.quest6`.

Departures from [F17]

* The unknown is ``q' = p q`` as in :mod:`quest.paper.quest6`.
* The candidates of the three lambdas are united.
* Candidates are refined on the quartics, since four monomials out of 35 carry all of the rounding and noise.
* Without translation the only candidate is the rotation that turns all rays m into n.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.geometry.quaternion import canonical, conjugate, multiply
from quest.paper.monomials import coefficient_rows, quartic_index
from quest.paper.newton import polish_on_quartics
from quest.paper.quest6 import LETTERS, PRE_ROTATION, as_batch, with_rotation_alone

Floats = NDArray[np.float64]

# Without noise the first step lowers the error from 1e-11 to rounding, and that of forward motion from 1e-4 to 1e-5.
# Under noise of 0.5 px two steps lower the mean error from .019 to .014.
_POLISHING_STEPS = 2

# i p: its w' is -x' of p. At w' = 0 the vector x1 = w'^3 q' vanishes and A2 loses its rank; a rotation with w' = 0 for
# p has w' = 0 for i p only by coincidence.
_OTHER_PRE_ROTATION = (-PRE_ROTATION[1], PRE_ROTATION[0], -PRE_ROTATION[3], PRE_ROTATION[2])

# The median inverse condition number is 1e-7. Below this bound the candidates are too inaccurate for refinement.
_BAD_CONDITION = 1e-11


def quest7(m: ArrayLike, n: ArrayLike, lambdas: str = "xyz") -> Floats:
    """Rotations cam2_from_cam1 that seven matches off a plane allow, by QuEst 7 [F17].

    Parameters
    ----------
    m, n : (N, 3) or (B, N, 3) float
        Bearings in camera 1 and camera 2, of any norm, N >= 7; all triples are used.
    lambdas : str
        The eigenproblems x^3/w^3, y^3/w^3, z^3/w^3 to solve; their candidates are united.

    Returns
    -------
    (K, 4) or (B, K, 4) float
        Unit quaternions wxyz, canonical in sign; K at most 4 for each lambda. One sample: only the
        candidates. A batch: padded with NaN. On points of a plane all candidates are wrong.

    Raises
    ------
    InputError
        If the shapes do not fit, N < 7, a number is not finite, a ray is zero, or a lambda is unknown.

    References
    ----------
    [F17] Fathian et al., arXiv:1704.02672, QuEst with seven points; departures in the module docstring.
    """
    m, n, single = as_batch(m, n, 7, lambdas)
    q, condition = _solve_rotated(m, n, lambdas, PRE_ROTATION)
    bad = condition < _BAD_CONDITION
    if bad.any():
        again, condition_again = _solve_rotated(m[bad], n[bad], lambdas, _OTHER_PRE_ROTATION)
        better = condition_again > condition[bad]
        q[bad] = np.where(better[:, None, None], again, q[bad])
    return with_rotation_alone(q, m, n, single)


def _solve_rotated(
    m: Floats, n: Floats, lambdas: str, before: tuple[float, float, float, float]
) -> tuple[Floats, Floats]:
    """Candidates (S, K, 4) through ``q' = p q``, p = before, and inverse condition numbers (S,) of A2."""
    A = coefficient_rows(m, n, before)
    problems, condition = cubed_eigenproblem(A, lambdas)
    q = np.concatenate([_candidates(B) for B in problems], axis=1)
    q = polish_on_quartics(A, q, steps=_POLISHING_STEPS)
    return canonical(multiply(conjugate(before), q)), condition


def cubed_eigenproblem(A: Floats, lambdas: str) -> tuple[list[Floats], Floats]:
    """The matrices of the eigenproblems ``lambda x1 = B x1``.

    Shapes: ``A`` (S, T, 35), returns ``B`` (S, 4, 4), returns ``condition`` (S,).

    * Returns ``condition``: Inverse condition number of A2, from 0 to 1: how well B is determined.
    """
    U, s, Vt = np.linalg.svd(A[..., 4:], full_matrices=False)
    largest = np.maximum(s[:, :1], 1e-100)
    # The same bound as in numpy.linalg.pinv: planes get the solution of least norm.
    inverse = np.where(s > 1e-15 * largest, 1 / np.maximum(s, 1e-15 * largest), 0.0)
    x2 = -(Vt.swapaxes(-1, -2) * inverse[:, None]) @ (U.swapaxes(-1, -2) @ A[..., :4])
    rows = {name: [quartic_index(a, a, a, b) - 4 for b in range(4)] for name, a in LETTERS.items()}
    return [x2[:, rows[name]] for name in lambdas], s[:, -1] / largest[:, 0]


def _candidates(B: Floats) -> Floats:
    """Quaternions (S, 4, 4) of the eigenvectors, one of each complex pair by its real part; else NaN."""
    values, vectors = np.linalg.eig(B)
    q = vectors.swapaxes(-1, -2)
    pivot = np.argmax(np.abs(q), axis=-1)[..., None]
    real = (q / np.take_along_axis(q, pivot, axis=-1)).real
    unit = real / np.linalg.norm(real, axis=-1, keepdims=True)
    return np.where((values.imag >= 0)[..., None], unit, np.nan)
