"""The rotation that explains most matches by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust.ransac import draw_samples

__all__ = ["fit_rotation", "refine_rotation_compiled"]

Floats = NDArray[np.float64]

#: The share of inliers of a hypothesis is known to 3 % from so many.
_JURY = 300


def fit_rotation(m: Floats, n: Floats, threshold_rad: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """The rotation that explains most matches, and its squared residuals (N,) per bearing in rad^2.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings, N >= 2.
    threshold_rad : float
        Residual from which on a match has little to say, as in :func:`quest.estimate_relative_pose`.
    rng : numpy.random.Generator
    """
    # 200 pairs hold one of two inliers with 99.97 % where a fifth of the matches are inliers.
    pairs = draw_samples(rng, len(m), 2, 200)
    frames = []
    for rays in (m[pairs], n[pairs]):
        across = np.cross(rays[:, 0], rays[:, 1])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        middle = rays[:, 0] + rays[:, 1]
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
        frames.append(np.stack([across, middle, np.cross(across, middle)], axis=-1))
    R = frames[1] @ np.swapaxes(frames[0], 1, 2)
    # Which of them is best is seen on some hundred matches. |n - R m|^2 / 2 = 1 - n . R m.
    some = rng.permutation(len(m))[:_JURY]
    r2 = 1 - R.reshape(-1, 9) @ (n[some, :, None] * m[some, None, :]).reshape(-1, 9).T
    best = R[int(np.argmin(np.minimum(r2, 4 * threshold_rad**2).sum(axis=1)))]
    # Wide first, so that a scene with a little parallax is still fitted as a whole.
    for scale_rad in (4 * threshold_rad, threshold_rad, 0.5 * threshold_rad):
        best = refine_rotation_compiled(best, m, n, scale_rad)
    return best, 0.5 * np.sum((n - m @ best.T) ** 2, axis=1)


def refine_rotation_compiled(R: Floats, m: Floats, n: Floats, scale_rad: float, iterations: int = 10) -> Floats:
    """As :func:`quest.geometry.refine.refine_rotation`, compiled."""
    from quest.robust import kernels

    R = R.copy()
    kernels.refine_rotation(np.ascontiguousarray(m), np.ascontiguousarray(n), R, scale_rad, iterations)
    return R
