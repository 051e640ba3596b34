"""The covariance of a pose from the residuals of its inliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.refine import sampson_jacobian
from quest.noise import GATE_SIGMAS
from quest.relative_pose import Hypothesis

__all__ = ["pose_covariance"]

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
    u = (r / (GATE_SIGMAS * noise_rad)) ** 2
    # The mean of psi' is at least 0.1, so that the covariance stays finite where the residuals are not Gaussian.
    spread = float(np.mean((r / (1 + u) ** 2) ** 2)) / max(float(np.mean((1 - 3 * u) / (1 + u) ** 3)), 0.1) ** 2
    return np.asarray(spread * np.linalg.pinv(J.T @ J, hermitian=True))
