"""The covariance of a pose from the residuals of its inliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.noise import GATE_SIGMAS, KERNEL_SIGMAS, LEAST_TYPICAL
from quest.relative_pose import Hypothesis
from quest.robust import kernels
from quest.uncertainty.parallax import eigen_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Least mean of psi', so that the covariance stays finite where the residuals are not Gaussian.
_LEAST_SLOPE = 0.1
#: Shares of the noise in J^T J that are subtracted: the first that leaves a tenth of the least eigenvalue. Where the
#: whole is too much, the parallax is not larger than the noise, and the covariance is a lower bound.
_SHARES_OF_NOISE, _LEAST_REST = (1.0, 0.9, 0.75, 0.5), 0.1
#: Fits of a plane: each leaves out what the one before shows to lie off it.
_PLANE_FITS = 5


def pose_covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float, outliers: float = 0.0) -> Floats:
    """Covariance (5, 5) of an M-estimate with the weights of Cauchy, from the inliers m, n (N, 3) of a pose.

    It is ``K^2 mean(psi^2) / mean(psi')^2`` times ``A^-1 J^T J A^-1``, psi the derivative of the kernel, in rad^2, in
    the unknowns of :attr:`quest.RelativePose.covariance`.

    * J are the derivatives of the matches of typical depth. An outlier that the motion explains by chance lies anywhere
      on its epipolar line, far from its neighbours, and would seem to determine t well: the coverage at 95 % was 28 to
      55 % where half of the matches are outliers and the parallax is small.
    * A is J^T J less what noise adds to it: the derivative by t is the parallax of a match, with its noise.
    * K corrects for the unknowns that the estimate has adapted to.

    A factor for few matches makes the ellipsoid of chi-square hold 95 %, as that of F would; another one stands for the
    share of outliers.

    P. J. Huber, E. M. Ronchetti, "Robust Statistics", 2009, section 7.6: the correction K.
    """
    R, t = hypothesis.R, hypothesis.t
    typical = np.ones(len(m), bool)
    kernels.mark_typical(m, n, R, t, typical)
    if typical.sum() > LEAST_TYPICAL:
        m, n = m[typical], n[typical]
    information, _, psi2, slope, slope2 = kernels.pose_information(m, n, R, t, KERNEL_SIGMAS * noise_rad)
    by_noise = kernels.ratio_sums(m, n, R, t)[3]
    count = len(m)
    mean = max(slope / count, _LEAST_SLOPE)
    correction = 1 + 5 / count * max(slope2 / count - (slope / count) ** 2, 0.0) / mean**2
    inverse = _pseudo_inverse(_without_noise(information, 2 * noise_rad**2 * by_noise))
    spread = correction**2 * _spread_of_means(count, 5, psi2 / count, slope / count)
    return np.asarray(_few_matches(count) * _wrong_inliers(count, outliers) * spread * inverse @ information @ inverse)


def _few_matches(count: int) -> float:
    """The factor by which the 95 % point of F with 5 and count - 5 degrees of freedom exceeds that of chi-square / 5.

    The residuals of few matches do not know their variance. The series is within 2 % from ten degrees of freedom on.
    """
    freedom = max(count - 5, 5)
    return 1 + 4.2 / freedom + 8 / freedom**2


def _wrong_inliers(count: int, outliers: float) -> float:
    """The factor for wrong matches among few inliers, by the share of outliers.

    It is measured: with 60 % outliers among 100 matches the ellipsoid of 40 inliers held 88 to 93 %, since half of
    these poses have a wrong match among their inliers. The 15 were chosen on other scenes than those of the table.
    """
    return 1 + 15 * outliers / max(count - 5, 5)


def _without_noise(information: Floats, by_noise: Floats) -> Floats:
    """J^T J (5, 5) less the part of noise (2, 2) in the direction, or less as much of it as leaves it regular."""
    least = eigen_of(information)[0].min()
    for share in _SHARES_OF_NOISE:
        rest = information.copy()
        rest[3:, 3:] -= share * by_noise
        if eigen_of(rest)[0].min() > _LEAST_REST * least:
            return rest
    return information.copy()


def plane_of_pose(pose: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> tuple[Floats, Bools]:
    """The plane ``k . X = 1`` (3,) of the matches m, n (N, 3) of a planar pose, and which of them lie on it (N,).

    A wrong match that the pose explains by chance lies anywhere on its epipolar line. One of them in a hundred turned
    the plane of least squares, so that the covariance was up to 40 times too large. So the fit is repeated without
    those that are farther off than three deviations.
    """
    # n x (R m + t (k . m)) = 0: each match says what k . m is.
    rotated, along = m @ pose.R.T, np.cross(n, pose.t)
    weights = np.sum(along**2, axis=1)
    products = -np.sum(along * np.cross(n, rotated), axis=1)
    on, k = np.ones(len(m), bool), np.zeros(3)
    for _ in range(_PLANE_FITS):
        weighted = weights[on, None] * m[on]
        k = np.linalg.lstsq(weighted.T @ m[on], m[on].T @ products[on], rcond=None)[0]
        depths = m @ k
        off_rad = np.abs(weights * depths - products) / np.sqrt(np.maximum(weights, 1e-300))
        off_rad /= np.maximum(np.linalg.norm(rotated + np.outer(depths, pose.t), axis=1), 1e-300)
        on = off_rad <= max(GATE_SIGMAS * np.sqrt(2) * noise_rad, GATE_SIGMAS * kernels.median_in_place(off_rad.copy()))
    return k, on


def planar_pose_covariance(
    hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float, outliers: float = 0.0
) -> Floats:
    """The same for a pose whose points lie on a plane ``k . X = 1``.

    The unknowns are the five of the pose and the three of k. A match has two residuals then, those of the homography
    ``R + t k^T``, so that the pose is better known than from epipolar lines alone.
    """
    scale_rad = GATE_SIGMAS * noise_rad
    information, psi2, slope = kernels.planar_information(m, n, hypothesis.R, hypothesis.t, scale_rad)
    residuals = 2 * len(m)
    spread = _spread_of_means(residuals, 8, psi2 / residuals, slope / residuals)
    return np.asarray(_wrong_inliers(len(m), outliers) * spread * _pseudo_inverse(information)[:5, :5])


def _pseudo_inverse(information: Floats) -> Floats:
    """The pseudo-inverse of a symmetric matrix (N, N); numpy takes 50 us for it."""
    values, vectors = eigen_of(information)
    used = np.abs(values) > 1e-15 * np.abs(values).max()
    return np.asarray((vectors[:, used] / values[used]) @ vectors[:, used].T)


def _spread_of_means(count: int, unknowns: int, psi2: float, slope: float) -> float:
    """Variance of a residual of an M-estimate, from the means of psi^2 and psi' over a number of residuals."""
    # The estimate has adapted to the residuals by as many of them as it has unknowns.
    freedom = count / max(count - unknowns, 1)
    return freedom * psi2 / max(slope, _LEAST_SLOPE) ** 2
