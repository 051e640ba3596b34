"""QuEst 6: the relative rotation from six matches, planes included.

[F17] (see :mod:`quest.solvers.monomials`), section "QuEst 6", in its letters. Six matches have 20 triples; each
puts a quartic on ``q = (w, x, y, z)``, and their 35 coefficients are the rows of A. With x1 the 20
monomials that hold w, and x2 the 15 that do not::

    A1 x1 + A2 x2 = 0      so      x2 = B' x1,     B' = -pinv(A2) A1

Multiply x1 by ``lambda = x / w``: each of its monomials turns into another one, which is an entry of x1 or,
through B', a combination of them. That is an eigenproblem of size 20 ::

    lambda x1 = B x1

whose eigenvectors hold the rotation. ``y / w`` and ``z / w`` give equally valid problems with other false
solutions.

Departures from [F17]

* q is read off the eigenvector by ratios of monomials, ``a^2 (w, x, y, z)`` with a the largest of the four,
  not by cube roots, which lose half of the accuracy under noise.
* The unknown is ``q' = p q`` with a fixed p: dividing by w fails at 180 degrees, the commonest rotation
  that has w = 0, and ``lambda = x / w`` is a multiple eigenvalue at the identity. :mod:`quest.solvers.printed`
  keeps the literal form.
* A complex pair of eigenvectors is a real solution that noise has pushed off the real axis: its real part
  is kept.
* Without translation all rows vanish to third order, A has rank 10 and A2 no pseudo-inverse to speak of.
  The rotation is then the one that turns all rays m into n, and is given as the only candidate (without
  noise, that is: with noise the quartics have solutions near it, and the parallax tells).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError
from quest.geometry.epipolar import as_matches
from quest.geometry.quaternion import canonical, conjugate, matrix_from_quaternion, multiply
from quest.solvers.monomials import QUARTICS, coefficient_rows, quartic_index

__all__ = [
    "LETTERS",
    "PRE_ROTATION",
    "TIMES",
    "quaternions_from_monomials",
    "quest6",
    "rotation_alone",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: The fixed rotation p of the public solvers, wxyz: of no particular direction, and with a w' of .71 at the
#: identity so that the small rotations between video frames stay far from w' = 0.
PRE_ROTATION: tuple[float, float, float, float] = (
    0.7103520703773498,
    0.38252034078307395,
    -0.29363885020383906,
    0.5126932324975441,
)

#: Position of the letters of lambda in a quaternion wxyz.
LETTERS = {"x": 1, "y": 2, "z": 3}

# R of a QR decomposition of A2 with a pivot this small relative to its largest has lost rank: rounding
# leaves about 1e-14, a translation of 1e-6 of the depths 1e-8.
_SINGULAR = 1e-11


#: For a letter a, where in the 35 monomials the 20 of ``(a / w) x1`` are.
TIMES: Ints = np.array([[quartic_index(a, *letters[1:]) for letters in QUARTICS[:20]] for a in range(4)])

#: For a pivot a, where in x1 the monomials ``w a^2 (w, x, y, z)`` are.
_RATIOS: Ints = np.array([[quartic_index(0, a, a, b) for b in range(4)] for a in range(4)])


def quest6(m: ArrayLike, n: ArrayLike, lambdas: str = "xyz") -> Floats:
    """Rotations cam2_from_cam1 that six matches allow, by QuEst 6 [F17].

    Parameters
    ----------
    m, n : (N, 3) or (B, N, 3) float
        Bearings in camera 1 and camera 2, of any norm, N >= 6; all triples are used.
    lambdas : str
        Which of the eigenproblems x/w, y/w, z/w to solve and unite: ``"x"`` is the fastest, ``"xyz"`` the
        most accurate.

    Returns
    -------
    (K, 4) or (B, K, 4) float
        Unit quaternions wxyz, canonical in sign; K at most 20 for each lambda. One sample: only the
        candidates. A batch: padded with NaN, a sample that determines no rotation holding nothing else. The
        true rotation is among many false ones: :func:`quest.solvers.selection.select_candidates` tells them apart.

    Raises
    ------
    InputError
        Where the shapes do not fit, N < 6, a number is not finite, a ray is zero, or a lambda unknown.

    References
    ----------
    [F17] Fathian et al., arXiv:1704.02672, QuEst with six points; departures in the module docstring.
    """
    m, n, single = as_batch(m, n, lambdas, at_least=6)
    still = rotation_alone(m, n)
    powers, regular = _powers(coefficient_rows(m, n, PRE_ROTATION))
    regular &= np.isnan(still[:, 0])
    q = np.concatenate([_candidates(powers, regular, LETTERS[a]) for a in lambdas], axis=1)
    q = canonical(multiply(conjugate(PRE_ROTATION), q))
    q[~regular, 0] = still[~regular]
    return q[0][np.isfinite(q[0, :, 0])] if single else q


def as_batch(m: ArrayLike, n: ArrayLike, lambdas: str, at_least: int) -> tuple[Floats, Floats, bool]:
    """The arguments of a solver, checked: bearings (B, N, 3), and whether they came as a single sample (N, 3)."""
    if not isinstance(lambdas, str) or not lambdas or set(lambdas) - set(LETTERS):
        raise InputError(f"lambdas is {lambdas!r}: give letters of 'xyz'")
    m, n = as_matches(m, n, at_least=at_least)
    return (m[None], n[None], True) if m.ndim == 2 else (m, n, False)


def _powers(A: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """All 35 monomials as combinations of x1: (B, 35, 20), and for which samples A2 has full rank (B,)."""
    A1, A2 = A[..., :20], A[..., 20:]
    Q, R = np.linalg.qr(A2)
    pivots = np.abs(np.diagonal(R, axis1=-2, axis2=-1))
    regular = pivots.min(axis=-1) > _SINGULAR * np.maximum(pivots.max(axis=-1), 1e-200)
    R = np.where(regular[:, None, None], R, np.eye(15))
    B = -np.linalg.solve(R, Q.swapaxes(-1, -2) @ A1)  # B' = -pinv(A2) A1
    return np.concatenate([np.broadcast_to(np.eye(20), (len(A), 20, 20)), B], axis=1), regular


def _candidates(powers: Floats, regular: NDArray[np.bool_], letter: int) -> Floats:
    """Rotations (B, 20, 4): eigenvectors of multiplication by ``letter / w``, NaN where there is none."""
    B = powers[:, TIMES[letter]]
    values, vectors = np.linalg.eig(np.where(regular[:, None, None], B, 0.0))
    q = quaternions_from_monomials(vectors.swapaxes(-1, -2))
    keep = regular[:, None] & (values.imag >= 0)
    return np.where(keep[..., None], q, np.nan)


def quaternions_from_monomials(x1: NDArray[np.complex128], ratios: Ints = _RATIOS) -> Floats:
    """Unit quaternions (..., 4) by ratios of monomials; the real parts of complex ones.

    Parameters
    ----------
    x1 : (..., X) complex
        Monomials of one degree.
    ratios : (4, 4) int
        For a pivot a, where in x1 the monomials ``common factor * (w, x, y, z)`` are, the one with the factor a being
        of no other letter but w.
    """
    powers = np.abs(x1[..., ratios[np.arange(4), np.arange(4)]])
    pivot = np.argmax(powers, axis=-1)
    q = np.take_along_axis(x1, ratios[pivot], axis=-1)
    phase = np.conj(np.take_along_axis(q, pivot[..., None], axis=-1))
    with np.errstate(divide="ignore", invalid="ignore"):  # a vector without any power is no rotation: NaN
        real = (q * (phase / np.abs(phase))).real
        return np.asarray(real / np.linalg.norm(real, axis=-1, keepdims=True))


def rotation_alone(m: Floats, n: Floats, tolerance_rad: float = 1e-6) -> Floats:
    """The rotation (B, 4) that turns bearings m into n (B, N, 3), NaN where none does within the tolerance.

    The default is a thousandth of a pixel of a camera of 1000 px: under it the quartics, of third order in
    the parallax, hold little more than rounding, and the error of this rotation is smaller than that of
    QuEst 6.

    The largest eigenvector of Davenport's matrix of ``sum n . R m`` as a form in q (B. K. P. Horn 1987,
    section 4).
    """
    S = np.einsum("bni,bnj->bij", m, n)
    trace = np.trace(S, axis1=-2, axis2=-1)
    K = np.empty((len(S), 4, 4))
    K[:, 0, 0] = trace
    K[:, 0, 1:] = K[:, 1:, 0] = np.stack(
        [S[:, 1, 2] - S[:, 2, 1], S[:, 2, 0] - S[:, 0, 2], S[:, 0, 1] - S[:, 1, 0]], axis=-1
    )
    K[:, 1:, 1:] = S + S.swapaxes(-1, -2) - trace[:, None, None] * np.eye(3)
    q = np.linalg.eigh(K)[1][:, :, -1]
    rotated = m @ matrix_from_quaternion(q).swapaxes(-1, -2)
    fits = np.linalg.norm(rotated - n, axis=-1).max(axis=-1) < tolerance_rad
    return np.where(fits[:, None], canonical(q), np.nan)
