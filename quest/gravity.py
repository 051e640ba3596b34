"""The pose of two views with known gravity, from samples of three matches.

Turned so that gravity is the third axis of both cameras, the rotation is one angle, q = (cos a/2, 0, 0, sin a/2). The
equation of QuEst for three matches, det [R m_i x n_i] = 0, is then a quartic in this quaternion, hence a trigonometric
polynomial of degree two in a: five of its values give its coefficients, and the roots on the unit circle the angles.

References
----------
.. [F10] F. Fraundorfer, P. Tanskanen, M. Pollefeys, "A minimal case solution to the calibrated relative pose problem
   for the case of two known orientation angles", ECCV 2010: the same quartic from the essential matrix.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.estimate import as_unit_bearings, checked_options, pose_of_bearings
from quest.relative_pose import NoPose, RelativePose
from quest.robust import kernels
from quest.robust.lo_ransac import Proposer
from quest.uncertainty.parallax import as_direction

if TYPE_CHECKING:
    from quest.robust.kernels.samples import Pool

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Number of matches in a sample: three fix the pose. Share of the samples without outliers that lead to the motion
#: after refinement.
_SAMPLE, _YIELD = 3, 0.3
#: Noise moves a double root off the unit circle; a root farther away than this is no angle.
_OFF_CIRCLE = 0.2


def estimate_upright_pose(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    gravity1: ArrayLike,
    gravity2: ArrayLike,
    *,
    threshold_rad: float = 2e-3,
    seed: int = 0,
    confidence: float = 0.999,
    max_samples: int = 5000,
) -> RelativePose | NoPose:
    """Estimate the motion between two calibrated views whose gravity is known, as from an IMU.

    Samples have three matches instead of five, so that fewer are needed where many matches are outliers. Gravity
    proposes motions only: all five unknowns are refined, so that its error is not in the result.

    Parameters
    ----------
    bearings1, bearings2 : (N, 3) array_like
        Matched rays in camera 1 and camera 2, of any length but zero.
    gravity1, gravity2 : (3,) array_like
        Direction of gravity in camera 1 and camera 2, of any length but zero. It may be wrong by about the angle of the
        parallax.
    threshold_rad : float
        A match whose Sampson error is larger is an outlier, in radians.
    seed : int
        Seed of the random samples.
    confidence : float
        Probability with which the best motion is found.
    max_samples : int
        Bound on the number of samples, hence on the time: about 30 microseconds each.

    Returns
    -------
    RelativePose or NoPose
        As of :func:`quest.estimate_relative_pose`, with kind, the other motion of a plane, parallax and covariance.

    Raises
    ------
    InputError
        If a gravity is zero or not finite, or another argument is refused by :func:`quest.estimate_relative_pose`.
    """
    m, n = as_unit_bearings(bearings1, bearings2)
    options = checked_options(len(m), threshold_rad, seed, confidence, max_samples)
    upright1, upright2 = (_upright(as_direction(gravity)) for gravity in (gravity1, gravity2))

    def _propose(m: Floats, n: Floats, samples: Ints, threshold_rad: float, pool: Pool) -> None:
        R, t = upright_poses(m[samples] @ upright1.T, n[samples] @ upright2.T)
        kernels.try_poses(m, n, upright2.T @ R @ upright1, t @ upright2, threshold_rad, pool)

    return pose_of_bearings(m, n, options, proposer=Proposer(_SAMPLE, _YIELD, _propose))


def upright_poses(m: Floats, n: Floats) -> tuple[Floats, Floats]:
    """All poses of samples of three matches whose third axis is gravity; t has either sign.

    Shapes: ``m, n`` (S, 3, 3), returns ``R`` (K, 3, 3), returns ``t`` (K, 3).
    """
    angles = 2 * np.pi * np.arange(5) / 5
    normals = np.cross(np.einsum("aij,skj->aski", _about_gravity(angles), m), n)
    # Coefficients of exp(i k a), k = -2 to 2: a polynomial in z = exp(i a) of degree four.
    coefficients = np.fft.fftshift(np.fft.fft(np.linalg.det(normals), axis=0) / 5, axes=0).T
    usable = np.abs(coefficients[:, 4]) > 1e-12 * np.abs(coefficients).max(axis=1)
    m, n, coefficients = m[usable], n[usable], coefficients[usable]
    companion = np.zeros((len(m), 4, 4), complex)
    companion[:, 1:, :3] = np.eye(3)
    companion[:, :, 3] = -coefficients[:, :4] / coefficients[:, 4:]
    roots = np.linalg.eigvals(companion)
    sample, which = np.nonzero(np.abs(np.abs(roots) - 1) < _OFF_CIRCLE)
    R = _about_gravity(np.angle(roots[sample, which]))
    normals = np.cross(np.einsum("kij,klj->kli", R, m[sample]), n[sample])
    return R, np.linalg.svd(normals)[2][:, 2]


def _about_gravity(angles: Floats) -> Floats:
    """Rotations (K, 3, 3) about the third axis."""
    R = np.zeros((len(angles), 3, 3))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(angles)
    R[:, 1, 0], R[:, 0, 1], R[:, 2, 2] = np.sin(angles), -np.sin(angles), 1
    return R


def _upright(gravity: Floats) -> Floats:
    """A rotation (3, 3) that takes gravity to the third axis."""
    side = np.cross(gravity, np.eye(3)[np.argmin(np.abs(gravity))])
    side /= np.linalg.norm(side)
    return np.array([side, np.cross(gravity, side), gravity])
