"""Two views of a scene at a known ratio of baseline and depth, and a motion that is refined from the true one."""

from dataclasses import dataclass

import numpy as np

from quest import parallax_statement
from quest.geometry.epipolar import sampson_error, tangent_basis
from quest.geometry.quaternion import rotation_from_vector
from quest.robust import kernels
from quest.uncertainty.parallax import LEAST_SINE2, RATIO_MADS
from tests.benchmarks.quest.reference import refine_pose

#: Half the field of view of 640x480 px at a focal length of 458 px.
_HALF_VIEW = np.array([0.7, 0.52])


@dataclass(frozen=True, eq=False)
class Views:
    """Matches of two views and their true motion; |t| = 1, and ``ratios`` are the true |t|/depth in camera 1."""

    m: np.ndarray
    n: np.ndarray
    R: np.ndarray
    t: np.ndarray
    ratios: np.ndarray


def draw_views(shape: str, count: int, ratio: float, noise_rad: float, rng: np.random.Generator) -> Views:
    """Draw two views: 4 degrees about a random axis, a random direction of translation, Gaussian noise in both.

    The scene is a box of depths 1 to 4, a tilted plane, or a wall at right angles to the axis. ``ratio`` is |t| divided
    by the median depth.
    """
    xy = rng.uniform(-1, 1, (count, 2)) * _HALF_VIEW
    if shape == "box":
        z = rng.uniform(1, 4, count)
    else:
        slope = rng.uniform(-0.7, 0.7, 2) if shape == "plane" else np.zeros(2)
        z = 2 / np.maximum(1 + xy @ slope, 0.3)
    points = np.column_stack([xy * z[:, None], z])
    depths = np.linalg.norm(points, axis=1)
    R = rotation_from_vector(np.deg2rad(4) * _unit(rng.normal(size=3)))
    t = _unit(rng.normal(size=3))
    length = ratio * float(np.median(depths))
    m, n = _unit(points), _unit(points @ R.T + length * t)
    return Views(_noisy(rng, m, noise_rad), _noisy(rng, n, noise_rad), R, t, length / depths)


def refined_motion(views: Views, noise_rad: float):
    """R, t and the inliers of the motion that is refined from the true one, and the statement about its parallax."""
    R, t, threshold = views.R, views.t, 3 * noise_rad
    gate = threshold
    for _ in range(3):
        residuals = sampson_error(R, t, views.m, views.n)
        kept = np.abs(residuals) < gate
        gate = min(threshold, 3 * float(np.sqrt(np.sum(residuals[kept] ** 2) / (kept.sum() - 5))))
        R, t = refine_pose(R, t, views.m[kept], views.n[kept], gate)
    kept = np.abs(sampson_error(R, t, views.m, views.n)) < gate
    wrong = int((~kept).sum())
    return R, t, kept, parallax_statement(R, t, views.m[kept], views.n[kept], wrong_matches=wrong)


def true_ratio(views: Views, R: np.ndarray, t: np.ndarray, kept: np.ndarray) -> float:
    """The true weighted mean of |t|/depth over the matches in the mean of the statement."""
    typical = kept.copy()
    kernels.mark_typical(views.m, views.n, R, t, RATIO_MADS, LEAST_SINE2, typical)
    sine2 = 1 - (views.n[typical] @ t) ** 2
    return float(sine2 @ views.ratios[typical] / sine2.sum())


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _noisy(rng: np.random.Generator, rays: np.ndarray, noise_rad: float) -> np.ndarray:
    shifts = noise_rad * rng.normal(size=(len(rays), 2))
    return _unit(rays + np.einsum("nij,nj->ni", tangent_basis(rays), shifts))
