"""The rotation that explains most matches by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.geometry.refine import refine_rotation
from quest.robust.ransac import draw_samples

__all__ = ["fit_rotation", "refine_rotation_compiled"]

Floats = NDArray[np.float64]

#: From this number of matches the share of inliers of a hypothesis is known to 3 %.
_TEST_MATCHES = 300

#: Two rays that are nearer to each other, or to opposite directions, determine no rotation: the frame that they span is
#: orthonormal to 1e-16 divided by this angle.
_LEAST_ANGLE_RAD = 1e-6


def fit_rotation(m: Floats, n: Floats, threshold_rad: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Fit the rotation that explains most matches.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2, N >= 2.
    threshold_rad : float
        Residual above which a match has little weight, as in :func:`quest.estimate_relative_pose`.
    rng : numpy.random.Generator

    Returns
    -------
    R : (3, 3) float
        Rotation of cam2_from_cam1.
    r2 : (N,) float
        Squared residuals per bearing, rad^2.
    """
    # Where a fifth of the matches are inliers, 200 pairs hold a pair of two inliers with a probability of 99.97 %.
    pairs = draw_samples(rng, len(m), 2, 200)
    frames, determined = [], np.ones(len(pairs), bool)
    for rays in (m[pairs], n[pairs]):
        across = np.cross(rays[:, 0], rays[:, 1])
        width = np.linalg.norm(across, axis=1, keepdims=True)
        across /= np.maximum(width, 1e-300)
        middle = rays[:, 0] + rays[:, 1]
        length = np.linalg.norm(middle, axis=1, keepdims=True)
        middle /= np.maximum(length, 1e-300)
        determined &= np.minimum(width, length)[:, 0] > _LEAST_ANGLE_RAD
        frames.append(np.stack([across, middle, np.cross(across, middle)], axis=-1))
    R = frames[1] @ np.swapaxes(frames[0], 1, 2)
    # Some hundred matches decide which rotation is best. |n - R m|^2 / 2 = 1 - n . R m.
    some = rng.permutation(len(m))[:_TEST_MATCHES]
    r2 = 1 - R.reshape(-1, 9) @ (n[some, :, None] * m[some, None, :]).reshape(-1, 9).T
    costs = np.where(determined, np.minimum(r2, 4 * threshold_rad**2).sum(axis=1), np.inf)
    # Where no pair determines a rotation, as where all rays are equal, the Kabsch fit gives one of those that fit best.
    best = R[int(np.argmin(costs))] if determined.any() else refine_rotation(np.eye(3), m, n, 1.0, iterations=1)
    # The wide scale first, so that a scene with a little parallax is fitted as a whole.
    for scale_rad in (4 * threshold_rad, threshold_rad, 0.5 * threshold_rad):
        best = refine_rotation_compiled(best, m, n, scale_rad)
    return best, 0.5 * np.sum((n - m @ best.T) ** 2, axis=1)


def refine_rotation_compiled(R: Floats, m: Floats, n: Floats, scale_rad: float, iterations: int = 10) -> Floats:
    """Refine a rotation as :func:`quest.geometry.refine.refine_rotation`, compiled.

    Parameters
    ----------
    R : (3, 3) float
        The start.
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    scale_rad : float
        Scale of the Geman-McClure kernel.
    iterations : int
        Largest number of steps.

    Returns
    -------
    (3, 3) float
    """
    from quest.robust import kernels

    R = R.copy()
    kernels.refine_rotation(np.ascontiguousarray(m), np.ascontiguousarray(n), R, scale_rad, iterations)
    return R
