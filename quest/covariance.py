"""The covariance of a pose from the residuals of its inliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.noise import KERNEL_SIGMAS
from quest.relative_pose import Hypothesis

Floats = NDArray[np.float64]


def pose_covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """Covariance (5, 5) of an M-estimate with the kernel of Geman and McClure, from the inliers m, n (N, 3) of a pose.

    It is ``mean(psi^2) / mean(psi')^2`` times the inverse of ``J^T J``, psi the derivative of the kernel; in rad^2, in
    the unknowns of :attr:`quest.RelativePose.covariance`.
    """
    from quest.robust import kernels

    information, _, psi2, slope = kernels.pose_information(m, n, hypothesis.R, hypothesis.t, KERNEL_SIGMAS * noise_rad)
    return _spread_of_means(len(m), 5, psi2 / len(m), slope / len(m)) * _pseudo_inverse(information)


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
    # The mean of psi' is at least 0.1, so that the covariance stays finite where the residuals are not Gaussian. The
    # estimate has adapted to the residuals by as many of them as it has unknowns.
    freedom = count / max(count - unknowns, 1)
    return freedom * psi2 / max(slope, 0.1) ** 2
