"""The covariance of a pose from the residuals of its inliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.homography import homography_residuals
from quest.geometry.quaternion import rotation_from_vector
from quest.geometry.refine import sampson_jacobian, tangent_basis
from quest.noise import GATE_SIGMAS
from quest.relative_pose import Hypothesis

__all__ = ["planar_pose_covariance", "pose_covariance"]

Floats = NDArray[np.float64]

#: Step of the numerical derivatives, in radians and in units of |t| over the distance.
_STEP = 1e-5


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
    B = tangent_basis(t)

    def residuals(x: Floats) -> Floats:
        direction = t + B @ x[3:5]
        H = rotation_from_vector(x[:3]) @ R + np.outer(direction / np.linalg.norm(direction), k + x[5:])
        return homography_residuals(H, m, n)

    # Central differences: the residuals are smooth, and errors of 1e-8 do not matter for a covariance.
    steps = _STEP * np.eye(8)
    J = np.stack([(residuals(step) - residuals(-step)) / (2 * _STEP) for step in steps], axis=-1)
    information = np.einsum("ijx,ijy->xy", J, J)
    r = residuals(np.zeros(8))
    # Two components of each residual vector: its tangents.
    components = np.concatenate([np.einsum("ij,ij->i", r, B_n) for B_n in np.moveaxis(tangent_basis(n), 2, 0)])
    covariance = _spread(components, noise_rad, 8) * np.linalg.pinv(information, hermitian=True)
    return np.asarray(covariance[:5, :5])


def _spread(r: Floats, noise_rad: float, unknowns: int) -> float:
    """Variance of a residual as an M-estimate of a number of unknowns has it."""
    u = (r / (GATE_SIGMAS * noise_rad)) ** 2
    # The mean of psi' is at least 0.1, so that the covariance stays finite where the residuals are not Gaussian. The
    # estimate has adapted to the residuals by as many of them as it has unknowns.
    freedom = len(r) / max(len(r) - unknowns, 1)
    return freedom * float(np.mean((r / (1 + u) ** 2) ** 2)) / max(float(np.mean((1 - 3 * u) / (1 + u) ** 3)), 0.1) ** 2
