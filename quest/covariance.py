"""The covariance of a pose from the residuals of its inliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.noise import KERNEL_SIGMAS
from quest.relative_pose import Hypothesis
from quest.uncertainty.parallax import LEAST_SINE2, RATIO_MADS

Floats = NDArray[np.float64]

#: Fewer matches than this are not sorted by their depth.
_LEAST_TYPICAL = 8
#: Least mean of psi', so that the covariance stays finite where the residuals are not Gaussian.
_LEAST_SLOPE = 0.1
#: Shares of the noise in J^T J that are subtracted: the first that leaves a tenth of the least eigenvalue. Where the
#: whole is too much, the parallax is not larger than the noise, and the covariance is a lower bound.
_SHARES_OF_NOISE, _LEAST_REST = (1.0, 0.9, 0.75, 0.5), 0.1


def pose_covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """Covariance (5, 5) of an M-estimate with the kernel of Geman and McClure, from the inliers m, n (N, 3) of a pose.

    It is ``K^2 mean(psi^2) / mean(psi')^2`` times ``A^-1 J^T J A^-1``, psi the derivative of the kernel, in rad^2, in
    the unknowns of :attr:`quest.RelativePose.covariance`.

    * J are the derivatives of the matches of typical depth. An outlier that the motion explains by chance lies anywhere
      on its epipolar line, far from its neighbours, and would seem to tell much about t: the coverage at 95 % was 28 to
      55 % where half of the matches are outliers and the parallax is small.
    * A is J^T J less what noise adds to it: the derivative by t is the parallax of a match, with its noise.
    * K corrects for the unknowns that the estimate has adapted to.

    A factor for few matches makes the ellipsoid of chi-square hold 95 %, as that of F would.

    P. J. Huber, E. M. Ronchetti, "Robust Statistics", 2009, section 7.6: the correction K.
    """
    from quest.robust import kernels

    R, t = hypothesis.R, hypothesis.t
    typical = np.ones(len(m), bool)
    kernels.mark_typical(m, n, R, t, RATIO_MADS, LEAST_SINE2, typical)
    if typical.sum() > _LEAST_TYPICAL:
        m, n = m[typical], n[typical]
    information, _, psi2, slope, slope2 = kernels.pose_information(m, n, R, t, KERNEL_SIGMAS * noise_rad)
    by_noise = kernels.ratio_sums(m, n, R, t, RATIO_MADS, LEAST_SINE2)[3]
    count = len(m)
    mean = max(slope / count, _LEAST_SLOPE)
    correction = 1 + 5 / count * max(slope2 / count - (slope / count) ** 2, 0.0) / mean**2
    inverse = _pseudo_inverse(_without_noise(information, 2 * noise_rad**2 * by_noise))
    spread = correction**2 * _spread_of_means(count, 5, psi2 / count, slope / count)
    return np.asarray(_few_matches(count) * spread * inverse @ information @ inverse)


def _few_matches(count: int) -> float:
    """The factor by which the 95 % point of F with 5 and count - 5 degrees of freedom exceeds that of chi-square / 5.

    The residuals of few matches do not know their variance. The series is within 2 % from ten degrees of freedom on.
    """
    freedom = max(count - 5, 5)
    return 1 + 4.2 / freedom + 8 / freedom**2


def _without_noise(information: Floats, by_noise: Floats) -> Floats:
    """J^T J (5, 5) less the part of noise (2, 2) in the direction, or less as much of it as leaves it regular."""
    least = _least_eigenvalue(information)
    for share in _SHARES_OF_NOISE:
        rest = information.copy()
        rest[3:, 3:] -= share * by_noise
        if _least_eigenvalue(rest) > _LEAST_REST * least:
            return rest
    return information.copy()


def _least_eigenvalue(information: Floats) -> float:
    from quest.robust import kernels

    values = information.copy()
    kernels.eigen_in_place(values, np.empty_like(values))
    return float(values.diagonal().min())


def planar_pose_covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """The same for a pose whose points lie on a plane ``k . X = 1``.

    The unknowns are the five of the pose and the three of k. A match has two residuals then, those of the homography
    ``R + t k^T``, so that the pose is better known than from epipolar lines alone.
    """
    from quest.robust import kernels

    scale_rad = KERNEL_SIGMAS * noise_rad
    information, psi2, slope = kernels.planar_information(m, n, hypothesis.R, hypothesis.t, scale_rad)
    residuals = 2 * len(m)
    spread = _spread_of_means(residuals, 8, psi2 / residuals, slope / residuals)
    return spread * _pseudo_inverse(information)[:5, :5]


def _pseudo_inverse(information: Floats) -> Floats:
    """The pseudo-inverse of a symmetric matrix (N, N), which is overwritten; numpy takes 50 us for it."""
    from quest.robust import kernels

    vectors = np.empty_like(information)
    kernels.eigen_in_place(information, vectors)
    values = information.diagonal()
    used = np.abs(values) > 1e-15 * np.abs(values).max()
    return np.asarray((vectors[:, used] / values[used]) @ vectors[:, used].T)


def _spread_of_means(count: int, unknowns: int, psi2: float, slope: float) -> float:
    """Variance of a residual of an M-estimate, from the means of psi^2 and psi' over a number of residuals."""
    # The estimate has adapted to the residuals by as many of them as it has unknowns.
    freedom = count / max(count - unknowns, 1)
    return freedom * psi2 / max(slope, _LEAST_SLOPE) ** 2
