"""QuEst 6: the relative rotation from six matches, planes included.

The notation is that of [F17] (see :mod:`quest.paper.monomials`), section "QuEst 6". Six matches have 20 triples. Each
triple gives a quartic in ``q = (w, x, y, z)``; the 35 coefficients of the quartics are the rows of A. With x1 the 20
monomials that contain w, and x2 the 15 other ones::

    A1 x1 + A2 x2 = 0      so      x2 = B' x1,     B' = -pinv(A2) A1

Multiply x1 by ``lambda = x / w``: each of its monomials becomes another monomial, which is an entry of x1 or, through
B', a combination of the entries of x1. This is an eigenproblem of size 20 ::

    lambda x1 = B x1

whose eigenvectors contain the rotation. ``y / w`` and ``z / w`` give equally valid problems with other false solutions.

Departures from [F17]

* q follows from the eigenvector by ratios of monomials, ``a^2 (w, x, y, z)`` with a the largest of the four, not by
  cube roots, which lose half of the accuracy under noise.
* The unknown is ``q' = p q`` with a fixed p. The reasons: division by w fails at rotations by 180 degrees, where w = 0,
  and ``lambda = x / w`` is a multiple eigenvalue at the identity. :mod:`quest.paper.printed` has the printed form.
* A complex pair of eigenvectors is a real solution that noise has moved off the real axis. Its real part is a
  candidate.
* Without translation all rows vanish to third order, A has rank 10, and A2 has no usable pseudo-inverse. The only
  candidate is then the rotation that turns all rays m into n. This is the case without noise; with noise the quartics
  have solutions near that rotation, and the parallax decides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError
from quest.geometry.epipolar import as_matches
from quest.geometry.quaternion import canonical, conjugate, matrix_from_quaternion, multiply
from quest.paper.monomials import QUARTICS, coefficient_rows, quartic_index

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: The fixed rotation p of the public solvers, wxyz, of no particular direction. At the identity w' is 0.71, so that the
#: small rotations between video frames are far from w' = 0.
PRE_ROTATION: tuple[float, float, float, float] = (
    0.7103520703773498,
    0.38252034078307395,
    -0.29363885020383906,
    0.5126932324975441,
)

#: Position of the letters of lambda in a quaternion wxyz.
LETTERS = {"x": 1, "y": 2, "z": 3}

# A matrix has lost rank where its QR decomposition has a pivot this small relative to the largest one: rounding leaves
# about 1e-14, a baseline of 1e-6 of the depths leaves 1e-8.
_SINGULAR = 1e-11
# Largest residual of a match that a rotation alone explains: a thousandth of a pixel at a focal length of 1000 px. With
# smaller residuals the quartics, of third order in the parallax, are little more than rounding errors, and the rotation
# is more accurate than that of QuEst 6.
_ROTATION_RAD = 1e-6


#: For a letter a, the positions of the 20 monomials of ``(a / w) x1`` among the 35 monomials.
TIMES: Ints = np.array([[quartic_index(a, *letters[1:]) for letters in QUARTICS[:20]] for a in range(4)])

#: For a pivot a, the positions of the monomials ``w a^2 (w, x, y, z)`` in x1.
RATIOS: Ints = np.array([[quartic_index(0, a, a, b) for b in range(4)] for a in range(4)])


def quest6(m: ArrayLike, n: ArrayLike, lambdas: str = "xyz") -> Floats:
    """Rotations cam2_from_cam1 that six matches allow, by QuEst 6 [F17].

    Parameters
    ----------
    m, n : (N, 3) or (B, N, 3) float
        Bearings in camera 1 and camera 2, of any norm, N >= 6; all triples are used.
    lambdas : str
        The eigenproblems x/w, y/w, z/w to solve; their candidates are united. ``"x"`` is the fastest, ``"xyz"`` the
        most accurate.

    Returns
    -------
    (K, 4) or (B, K, 4) float
        Unit quaternions wxyz, canonical in sign; K at most 20 for each lambda. One sample: only the
        candidates. A batch: padded with NaN; only NaN for a sample that determines no rotation. The true rotation is
        among many false ones: :func:`quest.paper.selection.select_candidates` ranks them.

    Raises
    ------
    InputError
        If the shapes do not fit, N < 6, a number is not finite, a ray is zero, or a lambda is unknown.

    References
    ----------
    [F17] Fathian et al., arXiv:1704.02672, QuEst with six points; departures in the module docstring.
    """
    m, n, single = as_batch(m, n, 6, lambdas)
    powers, regular = _powers(coefficient_rows(m, n, PRE_ROTATION))
    q = np.concatenate([_candidates(powers[:, TIMES[LETTERS[a]]]) for a in lambdas], axis=1)
    q[~regular] = np.nan
    return with_rotation_alone(canonical(multiply(conjugate(PRE_ROTATION), q)), m, n, single)


def as_batch(
    m: ArrayLike, n: ArrayLike, at_least: int, lambdas: str = "x", *, exactly: bool = False
) -> tuple[Floats, Floats, bool]:
    """Check the arguments of a solver; return batches, and whether one sample was given.

    Shapes: ``m, n`` (N, 3), returns ``m, n`` (B, N, 3).

    * ``exactly``: Whether the solver takes no more matches than ``at_least``.
    """
    if not isinstance(lambdas, str) or not lambdas or set(lambdas) - set(LETTERS):
        raise InputError(f"lambdas is {lambdas!r}: give letters of 'xyz'")
    m, n = as_matches(m, n, at_least=at_least)
    if exactly and m.shape[-2] > at_least:
        raise InputError(f"{m.shape[-2]} matches in a sample: give {at_least}")
    return (m[None], n[None], True) if m.ndim == 2 else (m, n, False)


def _powers(A: Floats) -> tuple[Floats, Bools]:
    """All 35 monomials as combinations of x1: (B, 35, 20), and for which samples A2 has full rank (B,)."""
    Q, R = np.linalg.qr(A[..., 20:])
    R, regular = regular_triangle(R)
    B = -np.linalg.solve(R, Q.swapaxes(-1, -2) @ A[..., :20])  # B' = -pinv(A2) A1
    return np.concatenate([np.broadcast_to(np.eye(20), (len(A), 20, 20)), B], axis=1), regular


def regular_triangle(R: Floats) -> tuple[Floats, Bools]:
    """Triangular matrices (B, D, D) of QR decompositions, the identity where rank is lost, and where it is not (B,)."""
    pivots = np.abs(np.diagonal(R, axis1=-2, axis2=-1))
    regular = pivots.min(axis=-1) > _SINGULAR * np.maximum(pivots.max(axis=-1), 1e-200)
    return np.where(regular[:, None, None], R, np.eye(R.shape[-1])), regular


def _candidates(B: Floats) -> Floats:
    """Rotations (B, 20, 4): eigenvectors of multiplication by ``lambda``, NaN where there is none."""
    values, vectors = np.linalg.eig(B)
    q = quaternions_from_monomials(vectors.swapaxes(-1, -2))
    return np.where((values.imag >= 0)[..., None], q, np.nan)


def quaternions_from_monomials(x1: NDArray[np.complex128], ratios: Ints = RATIOS) -> Floats:
    """Unit quaternions (..., 4) by ratios of monomials; the real parts of complex ones.

    Shapes: ``x1`` (..., X), ``ratios`` (4, 4), returns (..., 4).

    * ``ratios``: For a pivot a, the positions in x1 of the monomials ``common factor * (w, x, y, z)``. The monomial
      with the factor a contains no other letter but w.
    """
    powers = np.abs(x1[..., ratios[np.arange(4), np.arange(4)]])
    pivot = np.argmax(powers, axis=-1)
    q = np.take_along_axis(x1, ratios[pivot], axis=-1)
    phase = np.conj(np.take_along_axis(q, pivot[..., None], axis=-1))
    with np.errstate(divide="ignore", invalid="ignore"):  # a vector of zeros is no rotation: NaN
        real = (q * (phase / np.abs(phase))).real
        return np.asarray(real / np.linalg.norm(real, axis=-1, keepdims=True))


def with_rotation_alone(q: Floats, m: Floats, n: Floats, single: bool) -> Floats:
    """The candidates of samples, with the rotation as the only one where it explains a sample without translation.

    Shapes: ``q`` (B, K, 4), ``m, n`` (B, N, 3), returns (B, K, 4).

    * ``single``: Of the only sample, return the candidates without the padding: (K, 4).
    """
    rotation = rotation_alone(m, n)
    rotation_only = np.isfinite(rotation[:, 0])
    q[rotation_only] = np.nan
    q[rotation_only, 0] = rotation[rotation_only]
    return q[0][np.isfinite(q[0, :, 0])] if single else q


def rotation_alone(m: Floats, n: Floats) -> Floats:
    """The rotation that turns bearings m into n, for samples without translation.

    It is the eigenvector of the largest eigenvalue of Davenport's matrix: ``sum n . R m`` as a form in q.

    B. K. P. Horn, "Closed-form solution of absolute orientation using unit quaternions", JOSA A 4, 1987, section 4.

    Shapes: ``m, n`` (B, N, 3), returns (B, 4).

    * Returns: Unit quaternions of canonical sign; NaN where a match has a residual above ``_ROTATION_RAD``.
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
    fits = np.linalg.norm(rotated - n, axis=-1).max(axis=-1) < _ROTATION_RAD
    return np.where(fits[:, None], canonical(q), np.nan)
