"""Planes and lines among the points of a motion: the plane that explains most matches, and the width of a line."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quest.geometry.homography import decompose_homography, fit_homography, homography_residuals
from quest.geometry.quaternion import matrix_from_quaternion
from quest.robust.ransac import draw_samples

__all__ = ["PlaneFit", "fit_plane", "fit_plane_compiled", "off_line_rad", "off_line_rad_compiled"]

Floats = NDArray[np.float64]

#: A Gaussian error exceeds three standard deviations in 0.3 % of the cases.
_GATE_SIGMAS = 3.0
#: Fewer matches determine no plane: three fix it, and five have to confirm it.
_LEAST_ON_PLANE = 8
#: Number of samples of three matches. Where half of the matches lie on a plane, one in eight samples does.
_SAMPLES = 64


class PlaneFit(NamedTuple):
    """The plane that explains most inliers of a motion.

    Attributes
    ----------
    on, off : int
        Number of matches on the plane, and number of the other matches.
    along_rad : float
        Residual of the matches on the plane along their epipolar lines, as a standard deviation by the median: the
        noise, where the points do lie on a plane. Infinite where there is no plane.
    relief : float
        Sum over all matches of their squared residuals along the epipolar lines, in units of the noise, each at most 9.
        Without relief it has a chi-square distribution, with as many degrees of freedom as matches.
    poses : list of (7,) float
        The motions (q_wxyz, t) of the homography, |t| = 1, the one nearest to the given motion first. Empty where there
        is no plane.
    """

    on: int
    off: int
    along_rad: float
    relief: float
    poses: list[Floats]


def fit_plane(model: Floats, m: Floats, n: Floats, noise_rad: float) -> PlaneFit:
    """Fit the plane that explains most of the matches of a motion.

    Parameters
    ----------
    model : (7,) float
        The motion (q_wxyz, t).
    m, n : (N, 3) float
        Unit bearings of its inliers in camera 1 and camera 2.
    noise_rad : float
        Standard deviation of a bearing.

    Returns
    -------
    PlaneFit
        Without poses where less than half of the matches lie on a plane, or fewer than eight.
    """
    R, t = matrix_from_quaternion(model[:4]), model[4:]
    # The inverse depth of a point on a plane is k . m: project n x (R m + t (k . m)) = 0 on the epipolar line.
    a = m @ R.T
    n_cross_t = np.cross(n, t)
    lhs = -np.einsum("ij,ij->i", n_cross_t, np.cross(n, a))
    gain = np.einsum("ij,ij->i", n_cross_t, n_cross_t)
    k = _robust_plane(m, lhs, gain, noise_rad, np.random.default_rng(0))
    if k is None:
        return PlaneFit(0, len(m), np.inf, np.inf, [])
    gate2 = 2 * (_GATE_SIGMAS * noise_rad) ** 2
    H = R + np.outer(t, k)
    on_plane = np.sum(homography_residuals(H, m, n) ** 2, axis=1) < 2 * gate2
    for _ in range(3):
        # Where most points lie off the plane, they refute its other motion.
        if on_plane.sum() < max(_LEAST_ON_PLANE, 0.5 * len(m)):
            return PlaneFit(int(on_plane.sum()), int((~on_plane).sum()), np.inf, np.inf, [])
        H = fit_homography(m[on_plane], n[on_plane])
        on_plane = np.sum(homography_residuals(H, m, n) ** 2, axis=1) < gate2
    poses = _poses_of_plane(H, m[on_plane], model)
    on = int(on_plane.sum())
    # A residual across the epipolar line measures the motion, a residual along it measures the plane.
    lines = np.cross(n_cross_t, n)
    lines /= np.maximum(np.linalg.norm(lines, axis=1, keepdims=True), 1e-300)
    along = np.einsum("ij,ij->i", homography_residuals(H, m, n), lines)
    relief = float(np.minimum((along / noise_rad) ** 2, _GATE_SIGMAS**2).sum())
    deviation = 1.4826 * float(np.median(np.abs(along[on_plane]))) if on else np.inf
    return PlaneFit(on, len(m) - on, deviation, relief, poses)


def fit_plane_compiled(model: Floats, m: Floats, n: Floats, noise_rad: float) -> PlaneFit:
    """Fit a plane as :func:`fit_plane`, compiled; the samples are others.

    Parameters
    ----------
    model : (7,) float
        The motion (q_wxyz, t).
    m, n : (N, 3) float
        Unit bearings of its inliers in camera 1 and camera 2.
    noise_rad : float
        Standard deviation of a bearing.

    Returns
    -------
    PlaneFit
        Without poses where less than half of the matches lie on a plane, or fewer than eight.
    """
    from quest.robust import kernels

    R, t, k = kernels.rotation_of_model(model), model[4:].copy(), np.empty(3)
    if len(m) < _LEAST_ON_PLANE or not kernels.best_plane(m, n, R, t, _GATE_SIGMAS * noise_rad, _samples(), k):
        return PlaneFit(0, len(m), np.inf, np.inf, [])
    H, on_plane = R + t[:, None] * k, np.empty(len(m), bool)
    on, along_rad, relief = kernels.fit_plane(m, n, t, noise_rad, _GATE_SIGMAS, _LEAST_ON_PLANE, H, on_plane)
    poses = _poses_of_plane(H, m[on_plane], model) if np.isfinite(relief) else []
    return PlaneFit(on, len(m) - on, along_rad, relief, poses)


@cache
def _samples() -> Floats:
    """The random numbers of the samples of three matches; always the same, so that a plane has one answer."""
    return np.random.default_rng(0).random((_SAMPLES, 3))


def _poses_of_plane(H: Floats, m: Floats, model: Floats) -> list[Floats]:
    """The motions (q_wxyz, t) of a homography of points m (N, 3), the one nearest to the given motion first."""
    from quest.robust import kernels

    motions = decompose_homography(H, m)
    poses = [kernels.model_of_pose(R_i, t_i / np.linalg.norm(t_i)) for R_i, t_i, _ in motions if t_i.any()]
    # One of the two is the motion itself, up to noise; the other is its twin.
    poses.sort(key=lambda pose: -abs(float(pose[:4] @ model[:4])) - 0.25 * float(pose[4:] @ model[4:]))
    return poses


def off_line_rad_compiled(rays: Floats) -> float:
    """Distance of rays from a great circle as :func:`off_line_rad`, compiled.

    Parameters
    ----------
    rays : (N, 3) float
        Unit rays.

    Returns
    -------
    float
        Radians; zero for points on a line.
    """
    from quest.robust import kernels

    return kernels.off_line(rays, _GATE_SIGMAS)


def off_line_rad(rays: Floats) -> float:
    """Distance of rays from their best great circle, as a standard deviation by the median.

    Parameters
    ----------
    rays : (N, 3) float
        Unit rays.

    Returns
    -------
    float
        Radians; zero for points on a line.
    """
    weight = np.ones(len(rays))
    distance = np.zeros(len(rays))
    # A few rays off the line, outliers among them, must not tilt it: their weight falls with each step.
    for _ in range(4):
        normal = np.linalg.eigh((rays * weight[:, None]).T @ rays)[1][:, 0]
        distance = np.abs(rays @ normal)
        scale = max(1.4826 * float(np.median(distance)), 1e-12)
        weight = 1 / (1 + (distance / (_GATE_SIGMAS * scale)) ** 2) ** 2
    return 1.4826 * float(np.median(distance))


def _robust_plane(m: Floats, lhs: Floats, gain: Floats, noise_rad: float, rng: np.random.Generator) -> Floats | None:
    """The plane k (3,) with ``gain (k . m) = lhs`` for most points: the best of samples of three."""
    if len(m) < _LEAST_ON_PLANE:
        return None
    samples = draw_samples(rng, len(m), 3, _SAMPLES)
    A = m[samples] * gain[samples][..., None]
    keep = np.abs(np.linalg.det(A)) > 1e-30
    if not keep.any():
        return None
    planes = np.linalg.solve(A[keep], lhs[samples][keep][..., None])[..., 0]
    # Displacement along the epipolar line, in units of the noise of one bearing.
    root = np.sqrt(np.maximum(gain, 1e-300))
    residual = np.abs((planes @ m.T) * root - lhs / root) / np.sqrt(2.0)
    limit = _GATE_SIGMAS * noise_rad
    return np.asarray(planes[int(np.argmin(np.minimum(residual, limit).sum(axis=1)))])
