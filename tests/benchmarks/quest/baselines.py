"""The classical solvers that QuEst is compared with: bearings in, quaternions of candidates out.

All are written in numpy for batches of samples, so that the comparison is fair and one test suite covers all solvers.
Each essential matrix gives its two rotations, the twisted pair. The translation follows from
:func:`quest.paper.selection.select_candidates` or :func:`quest.translation_and_depths`, as for QuEst.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError
from quest.geometry.epipolar import as_matches, tangent_basis
from quest.geometry.homography import decompose_homography
from quest.geometry.quaternion import quaternion_from_matrix
from quest.paper.quest6 import with_rotation_alone

Floats = NDArray[np.float64]

# Exponents of the 20 monomials of x, y, z up to degree three: the ten cubics, then the monomials of lower degree.
_CUBICS = [(3, 0, 0), (2, 1, 0), (1, 2, 0), (0, 3, 0), (2, 0, 1), (1, 1, 1), (0, 2, 1), (1, 0, 2), (0, 1, 2), (0, 0, 3)]
_LOWER = [(2, 0, 0), (1, 1, 0), (0, 2, 0), (1, 0, 1), (0, 1, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)]
# x times the ten lower monomials: the first six become cubics (their positions), the others become lower monomials.
_CUBIC_OF = [0, 1, 2, 4, 5, 7]
_LOWER_OF = [0, 1, 3, 6]
# For a pivot a of the letters x, y, z the positions of a^2 (x, y, z) in the cubics.
_RATIOS = np.array([[0, 1, 4], [2, 3, 6], [7, 8, 9]])
# det(c A + s B) is a cubic form in (c, s). Its values at four angles determine it.
_ANGLES = np.pi * np.arange(4) / 4
_PENCIL_NODES = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_PENCIL_COEFFICIENTS = np.linalg.inv([[c**3, c * c * s, c * s * s, s**3] for c, s in _PENCIL_NODES])
_QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# A root x is complex where |imaginary| / |x| exceeds this bound, an eigenvalue where |imaginary| / (1 + |x|) does:
# rounding separates a double one by sqrt(1e-16).
_REAL = 1e-7
# Smallest singular value of a homography relative to the largest one. Three rays in a plane give a homography without
# inverse, which belongs to no motion.
_SINGULAR = 1e-9


def _nodes(seed: int, exponents: Floats) -> tuple[Floats, Floats]:
    """Fixed points, as many as monomials, and the inverse of their monomials; the best of 1000 seeds."""
    points = np.random.default_rng(seed).normal(size=exponents.shape)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, np.linalg.inv((points[:, None] ** exponents).prod(axis=-1))


# Condition numbers 26 and 10.
_NODES_OF_FOUR = _nodes(905, np.array([(*e, 3 - sum(e)) for e in _CUBICS + _LOWER]))
_NODES_OF_THREE = _nodes(332, np.array(_CUBICS))
# A fixed rotation of the null space. Without it the basis has the symmetry of the scene: for a motion along x without
# rotation one of the four basis matrices is E itself, and the equations are singular.
_MIXING = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]


def _as_samples(m: ArrayLike, n: ArrayLike, at_least: int, at_most: int | None = None) -> tuple[Floats, Floats, bool]:
    """Check the arguments of a solver.

    Shapes: ``m, n`` (N, 3), returns ``m, n`` (B, N, 3).
    """
    m, n = as_matches(m, n, at_least=at_least)
    if at_most is not None and m.shape[-2] > at_most:
        raise InputError(f"{m.shape[-2]} matches in a sample: give {at_most}")
    return (m[None], n[None], True) if m.ndim == 2 else (m, n, False)


def _null_space(m: Floats, n: Floats, dimensions: int) -> Floats:
    """Basis of the matrices E that fulfil ``n . E m = 0`` best.

    Shapes: ``m, n`` (B, N, 3), returns (B, dimensions, 3, 3).
    """
    rows = (n[..., :, None] * m[..., None, :]).reshape(*m.shape[:2], 9)
    # R of a QR decomposition in place of the rows: the singular value decomposition is then of at most nine rows.
    V = np.linalg.svd(np.linalg.qr(rows, mode="r"))[2]
    return np.asarray(V[:, 9 - dimensions :].reshape(len(m), dimensions, 3, 3))


def _constraints(E: Floats) -> Floats:
    """Ten cubics that vanish for essential matrices: ``2 E E'E - tr(E E') E`` and ``det E``.

    Shapes: ``E`` (..., 3, 3), returns (..., 10).
    """
    EEt = E @ E.swapaxes(-1, -2)
    trace = np.trace(EEt, axis1=-2, axis2=-1)[..., None, None]
    nine = (2 * EEt @ E - trace * E).reshape(*E.shape[:-2], 9)
    return np.concatenate([nine, np.linalg.det(E)[..., None]], axis=-1)


def rotations_of_essential(E: Floats) -> Floats:
    """The two rotations of essential matrices.

    R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2004, section 9.6.2.

    Shapes: ``E`` (..., 3, 3), returns (..., 2, 4).

    * ``E``: Any matrices: the nearest essential matrix is decomposed. NaN gives NaN.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(E).all(axis=(-1, -2)))
    U, _, Vt = np.linalg.svd(np.where(known[..., None, None], E, np.eye(3)))
    # The signs of E, U and V are free: choose the ones that make U and V rotations.
    U = U * np.sign(np.linalg.det(U))[..., None, None]
    Vt = Vt * np.sign(np.linalg.det(Vt))[..., None, None]
    R = np.stack([U @ _QUARTER_TURN @ Vt, U @ _QUARTER_TURN.T @ Vt], axis=-3)
    return np.where(known[..., None, None], quaternion_from_matrix(R), np.nan)


def _equations(nodes: tuple[Floats, Floats], basis: Floats) -> Floats:
    """The coefficients of the constraints, without symbolic algebra: interpolated from the values at fixed points."""
    points, inverse = nodes
    values = _constraints(np.tensordot(points, basis, axes=(1, 1)).swapaxes(0, 1))
    return np.asarray((inverse @ values).swapaxes(-1, -2))


def five_point(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the essential matrices that five matches allow.

    ``E = x E1 + y E2 + z E3 + E4`` is in the null space of the epipolar equations. The ten cubic constraints are solved
    for the ten monomials of degree three, which gives the matrix of multiplication by x on the other ten monomials. Its
    real eigenvectors contain (x, y, z). Points on a plane are solved too; the candidates contain both of their motions.

    H. Stewenius, C. Engels, D. Nister, "Recent developments on direct relative orientation", ISPRS Journal 60, 2006.

    Shapes: ``m, n`` (5, 3), returns (K, 4).

    * Returns: Unit quaternions wxyz, canonical in sign, two for each of at most ten essential matrices; the form is
      that of :func:`quest.paper.quest6`.
    """
    m, n, single = _as_samples(m, n, at_least=5, at_most=5)
    basis = np.einsum("kl,blij->bkij", _MIXING, _null_space(m, n, 4))
    equations = _equations(_NODES_OF_FOUR, basis)
    leading = equations[..., :10]
    # Singular without translation, see `with_rotation_alone`. No other singular scene is known.
    regular = np.linalg.cond(leading) < 1 / np.finfo(float).eps
    leading = np.where(regular[:, None, None], leading, np.eye(10))
    cubics = -np.linalg.solve(leading, equations[..., 10:])
    action = np.zeros((len(m), 10, 10))
    action[:, :6] = cubics[:, _CUBIC_OF]
    action[:, np.arange(6, 10), _LOWER_OF] = 1.0
    values, vectors = np.linalg.eig(action)
    real = (np.abs(values.imag) <= _REAL * (1 + np.abs(values))) & regular[:, None]
    # (x, y, z, 1) up to a factor; the scale of E is free.
    E = np.einsum("bke,bkij->beij", vectors[:, 6:].real, basis)
    E = np.where(real[..., None, None], E, np.nan)
    return with_rotation_alone(rotations_of_essential(E).reshape(len(m), 20, 4), m, n, single)


def six_point(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the essential matrix of six matches, linearly.

    ``E = x E1 + y E2 + z E3`` of the null space of the epipolar equations turns the ten cubic constraints of essential
    matrices into ten equations in ten monomials. They are solved as if the monomials were independent unknowns. For
    points on a plane there is more than one solution, and the rotations are wrong.

    J. Philip, "Critical point configurations of the 5-, 6-, 7-, and 8-point algorithms for relative orientation",
    TRITA-MAT-1998-MA-13, KTH, 1998.

    Shapes: ``m, n`` (N, 3), returns (2, 4).

    * ``m, n``: Bearings in camera 1 and camera 2, of any norm, N >= 6; more than six in least squares.
    * Returns: Unit quaternions wxyz, canonical in sign, the twisted pair; the form is that of
      :func:`quest.paper.quest6`.
    """
    m, n, single = _as_samples(m, n, at_least=6)
    basis = _null_space(m, n, 3)
    monomials = np.linalg.svd(_equations(_NODES_OF_THREE, basis))[2][:, -1]
    pivot = np.argmax(np.abs(monomials[:, _RATIOS[np.arange(3), np.arange(3)]]), axis=1)
    xyz = np.take_along_axis(monomials, _RATIOS[pivot], axis=1)
    return with_rotation_alone(rotations_of_essential(np.einsum("bk,bkij->bij", xyz, basis)), m, n, single)


def seven_point(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the singular matrices ``n . E m = 0`` that seven matches allow.

    The matrices of the pencil E = c A + s B with det E = 0 are the solutions, at most three. Each gives the rotations
    of the nearest essential matrix. For points on a plane the pencil has three dimensions, and the rotations are wrong.

    R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2004, section 11.1.2.

    Shapes: ``m, n`` (N, 3), returns (K, 4).

    * ``m, n``: Bearings in camera 1 and camera 2, of any norm, N >= 7; more than seven in least squares.
    * Returns: Unit quaternions wxyz, canonical in sign, in the form of :func:`quest.paper.quest6`.
    """
    m, n, single = _as_samples(m, n, at_least=7)
    pencil = _null_space(m, n, 2)
    values = np.linalg.det(np.tensordot(_PENCIL_NODES, pencil, axes=(1, 1)).swapaxes(0, 1))
    c, s = np.moveaxis(_roots(values @ _PENCIL_COEFFICIENTS.T), -1, 0)
    E = c[..., None, None] * pencil[:, None, 0] + s[..., None, None] * pencil[:, None, 1]
    return with_rotation_alone(rotations_of_essential(E).reshape(len(m), 6, 4), m, n, single)


def _roots(form: Floats) -> Floats:
    """Real roots (B, 3, 2) of cubic forms (B, 4) ``c^3, c^2 s, c s^2, s^3`` on the unit circle; NaN if complex."""
    # Divide by the larger of the first and the last coefficient, so that no root is infinite: the unknown is c/s or
    # s/c.
    swap = np.abs(form[:, 3]) > np.abs(form[:, 0])
    form = np.where(swap[:, None], form[:, ::-1], form)
    companion = np.zeros((len(form), 3, 3))
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    # All four coefficients vanish where every matrix of the pencil is singular. Any root is right then; here it is
    # zero.
    companion[:, 0] = -form[:, 1:] / np.where(form[:, :1] == 0, 1.0, form[:, :1])
    x = np.linalg.eigvals(companion)
    real = np.abs(x.imag) <= _REAL * np.abs(x)
    circle = np.stack([x.real, np.ones(x.shape)], axis=-1)
    circle = np.where(swap[:, None, None], circle[..., ::-1], circle)
    circle = circle / np.linalg.norm(circle, axis=-1, keepdims=True)
    return np.where(real[..., None], circle, np.nan)


def eight_point(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the essential matrix that fits eight or more matches best.

    ``n . E m = 0`` is solved in least squares over E of unit norm. Bearings of unit norm need no normalization by
    Hartley's method. For points on a plane three dimensions of E fit, and the rotations are wrong.

    H. C. Longuet-Higgins, "A computer algorithm for reconstructing a scene from two projections", Nature 293, 1981.

    Shapes: ``m, n`` (N, 3), returns (2, 4).

    * Returns: Unit quaternions wxyz, canonical in sign, the twisted pair; the form is that of
      :func:`quest.paper.quest6`.
    """
    m, n, single = _as_samples(m, n, at_least=8)
    return with_rotation_alone(rotations_of_essential(_null_space(m, n, 1)[:, 0]), m, n, single)


def homography(m: ArrayLike, n: ArrayLike) -> Floats:
    """Rotations cam2_from_cam1 of the two motions that the homography of four or more matches allows.

    :func:`quest.geometry.homography.decompose_homography` has the method. For points that lie on no plane the
    rotations are wrong.

    Y. Ma, S. Soatto, J. Kosecka, S. Sastry, "An Invitation to 3-D Vision", 2004, section 5.3.3.

    Shapes: ``m, n`` (N, 3), returns (K, 4).

    * Returns: Unit quaternions wxyz, canonical in sign, in the form of :func:`quest.paper.quest6`.
    """
    m, n, single = _as_samples(m, n, at_least=4)
    q = np.full((len(m), 2, 4), np.nan)
    # The two components of n x Hm orthogonal to n.
    rows = np.einsum("bnik,bnj->bnkij", tangent_basis(n), m).reshape(len(m), -1, 9)
    for found, H, rays in zip(q, np.linalg.svd(rows)[2][:, -1].reshape(-1, 3, 3), m, strict=True):
        if np.linalg.cond(H) < 1 / _SINGULAR:
            for k, (R, _, _) in enumerate(decompose_homography(H, rays)):
                found[k] = quaternion_from_matrix(R)
    return with_rotation_alone(q, m, n, single)
