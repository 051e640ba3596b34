"""The plane that explains most matches of a motion, and the motions of its homography."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quest.geometry.homography import decompose_homography
from quest.robust import kernels

Floats = NDArray[np.float64]

#: A Gaussian error exceeds three standard deviations in 0.3 % of the cases.
_GATE_SIGMAS = 3.0
#: Fewer matches determine no plane: three fix it, and five have to confirm it.
_LEAST_ON_PLANE = 8
#: Number of samples of three matches. Where half of the matches lie on a plane, one in eight samples does.
_SAMPLES = 64


class PlaneFit(NamedTuple):
    """The plane that explains most inliers of a motion."""

    #: on, off: Number of matches on the plane, and number of the other matches.
    on: int
    off: int
    #: Sum over all matches of their squared residuals along the epipolar lines, in units of the noise, each at most
    #: 9. Without depth variation it has a chi-square distribution, with as many degrees of freedom as matches.
    depth_variation: float
    #: (7,) The motions (q_wxyz, t) of the homography, |t| = 1, the one nearest to the given motion first. Empty where
    #: there is no plane.
    poses: list[Floats]
    #: (3,) The unit normal of the plane in camera 1 of each of these motions.
    normals: list[Floats]
    #: (3, 3) The homography, of positive determinant: it takes a ray of camera 1 in front to one of camera 2 in front.
    H: Floats


def fit_plane(model: Floats, m: Floats, n: Floats, noise_rad: float) -> PlaneFit:
    """Fit the plane that explains most of the matches m, n (N, 3) of a motion (q_wxyz, t).

    It has no poses where less than half of the matches lie on a plane, or fewer than eight: most points off the plane
    refute its other motion.
    """
    R, t, k = kernels.rotation_of_model(model), model[4:].copy(), np.empty(3)
    if len(m) < _LEAST_ON_PLANE or not kernels.best_plane(m, n, R, t, _GATE_SIGMAS * noise_rad, _samples(), k):
        return PlaneFit(0, len(m), np.inf, [], [], np.eye(3))
    H, on_plane = R + t[:, None] * k, np.empty(len(m), bool)
    on, depth_variation = kernels.fit_plane(m, n, t, noise_rad, _GATE_SIGMAS, _LEAST_ON_PLANE, H, on_plane)
    motions = _motions_of_plane(H, m[on_plane], model) if np.isfinite(depth_variation) else []
    poses, normals = [pose for pose, _ in motions], [normal for _, normal in motions]
    return PlaneFit(on, len(m) - on, depth_variation, poses, normals, H if np.linalg.det(H) > 0 else -H)


@cache
def _samples() -> Floats:
    """The random numbers of the samples of three matches; always the same, so that a plane has one answer."""
    return np.random.default_rng(0).random((_SAMPLES, 3))


def _motions_of_plane(H: Floats, m: Floats, model: Floats) -> list[tuple[Floats, Floats]]:
    """The motions (q_wxyz, t) of a homography of points m (N, 3) and their normals, that of the given motion first."""
    motions = decompose_homography(H, m)
    found = [(kernels.model_of_pose(R_i, t_i / np.linalg.norm(t_i)), k_i) for R_i, t_i, k_i in motions if t_i.any()]
    # One of the two is the motion itself, up to noise; the other is the second motion of the plane.
    found.sort(key=lambda one: -abs(float(one[0][:4] @ model[:4])) - 0.25 * float(one[0][4:] @ model[4:]))
    return found
