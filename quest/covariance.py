"""The covariance of a pose from the residuals of its inliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.homography import homography_residuals
from quest.geometry.refine import sampson_jacobian, tangent_basis
from quest.noise import GATE_SIGMAS
from quest.relative_pose import Hypothesis

__all__ = [
    "planar_pose_covariance",
    "planar_pose_covariance_compiled",
    "pose_covariance",
    "pose_covariance_compiled",
]

Floats = NDArray[np.float64]


def pose_covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """Covariance of an M-estimate with the kernel of Geman and McClure.

    It is ``mean(psi^2) / mean(psi')^2`` times the inverse of ``J^T J``, psi the derivative of the kernel.

    Parameters
    ----------
    hypothesis : Hypothesis
        A refined pose and its inliers.
    m, n : (N, 3) float
        Unit bearings of all matches in camera 1 and camera 2.
    noise_rad : float
        Standard deviation of a bearing.

    Returns
    -------
    (5, 5) float
        In rad^2, in the unknowns of :attr:`quest.RelativePose.covariance`.
    """
    inliers = hypothesis.inliers
    r, J = sampson_jacobian(hypothesis.R, hypothesis.t, m[inliers], n[inliers])
    return np.asarray(_spread(r, noise_rad, J.shape[1]) * np.linalg.pinv(J.T @ J, hermitian=True))


def pose_covariance_compiled(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """Covariance of an M-estimate as :func:`pose_covariance`, compiled.

    Parameters
    ----------
    hypothesis : Hypothesis
        A refined pose.
    m, n : (N, 3) float
        Unit bearings of its inliers in camera 1 and camera 2.
    noise_rad : float
        Standard deviation of a bearing.

    Returns
    -------
    (5, 5) float
        In rad^2, in the unknowns of :attr:`quest.RelativePose.covariance`.
    """
    from quest.robust import kernels

    information, _, psi2, slope = kernels.pose_information(m, n, hypothesis.R, hypothesis.t, GATE_SIGMAS * noise_rad)
    return _spread_of_means(len(m), 5, psi2 / len(m), slope / len(m)) * _pseudo_inverse(information)


def planar_pose_covariance_compiled(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """Covariance of the pose of a plane as :func:`planar_pose_covariance`, compiled.

    Parameters
    ----------
    hypothesis : Hypothesis
        A pose of the homography.
    m, n : (N, 3) float
        Unit bearings of its inliers in camera 1 and camera 2.
    noise_rad : float
        Standard deviation of a bearing.

    Returns
    -------
    (5, 5) float
        In rad^2, in the unknowns of :attr:`quest.RelativePose.covariance`.
    """
    from quest.robust import kernels

    gate_rad = GATE_SIGMAS * noise_rad
    information, psi2, slope = kernels.planar_information(m, n, hypothesis.R, hypothesis.t, gate_rad)
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


def planar_pose_covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """The same for a pose whose points lie on a plane ``k . X = 1``.

    The unknowns are the five of the pose and the three of k. A match has two residuals then, those of the homography
    ``R + t k^T``, so that the pose is better known than from epipolar lines alone.

    Parameters
    ----------
    hypothesis : Hypothesis
        A pose of the homography and its inliers.
    m, n : (N, 3) float
        Unit bearings of all matches in camera 1 and camera 2.
    noise_rad : float
        Standard deviation of a bearing.

    Returns
    -------
    (5, 5) float
        In rad^2, in the unknowns of :attr:`quest.RelativePose.covariance`.
    """
    R, t, inliers = hypothesis.R, hypothesis.t, hypothesis.inliers
    m, n = m[inliers], n[inliers]
    # n x (R m + t (k . m)) = 0 is linear in k.
    n_cross_t, n_cross_a = np.cross(n, t), np.cross(n, m @ R.T)
    k = np.linalg.lstsq((n_cross_t[:, :, None] * m[:, None, :]).reshape(-1, 3), -n_cross_a.reshape(-1), rcond=None)[0]
    rotated = m @ R.T
    y = rotated + np.outer(m @ k, t)
    # Derivatives of y = R m + t (k . m) by w, b and k: columns e_i x R m, (k . m) B_j and m_l t.
    dy = np.concatenate(
        [
            np.cross(np.eye(3)[None], rotated[:, None, :]).swapaxes(1, 2),
            (m @ k)[:, None, None] * tangent_basis(t)[None],
            t[None, :, None] * m[:, None, :],
        ],
        axis=2,
    )
    # The residual is the part of y / |y| that is tangent to n; on its line y is n up to the noise.
    basis = tangent_basis(n)
    J = np.einsum("nia,nix->nax", basis, dy) / (np.sqrt(2.0) * np.linalg.norm(y, axis=1))[:, None, None]
    r = np.einsum("nia,ni->na", basis, homography_residuals(R + np.outer(t, k), m, n))
    information = np.einsum("nax,nay->xy", J, J)
    covariance = _spread(r.reshape(-1), noise_rad, J.shape[2]) * np.linalg.pinv(information, hermitian=True)
    return np.asarray(covariance[:5, :5])


def _spread(r: Floats, noise_rad: float, unknowns: int) -> float:
    """Variance of a residual as an M-estimate of a number of unknowns has it."""
    u = (r / (GATE_SIGMAS * noise_rad)) ** 2
    means = float(np.mean((r / (1 + u) ** 2) ** 2)), float(np.mean((1 - 3 * u) / (1 + u) ** 3))
    return _spread_of_means(len(r), unknowns, *means)


def _spread_of_means(count: int, unknowns: int, psi2: float, slope: float) -> float:
    """The same from the means of psi^2 and psi' over a number of residuals."""
    # The mean of psi' is at least 0.1, so that the covariance stays finite where the residuals are not Gaussian. The
    # estimate has adapted to the residuals by as many of them as it has unknowns.
    freedom = count / max(count - unknowns, 1)
    return freedom * psi2 / max(slope, 0.1) ** 2
