"""The lens of all frames of a stretch of video: a bundle adjustment whose lens is free.

Where a camera drives straight ahead, each frame has little information about the focal length: a longer lens sees a
scene that is stretched along the optical axis in the same way. Where the lens bends strongly, a polynomial with one
coefficient fits the centre of the image or its border. All frames of some seconds together determine both, by matches
that do not drift. Unknown are the poses, the points, the focal length, two coefficients of the radial distortion, and
the principal point. The lens has a prior.

Robustness and elimination are those of the map (:mod:`slam_init.bundle.adjustment`, :mod:`slam_init.bundle.focal`). The
better the lens, the lower the noise of the residuals, and the more of them are outliers. The deviations are the
larger of two: by the curvature of the cost, and by the scatter of the scores of the regions of the image (White 1980),
which knows errors that neighbours share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from slam_init.bundle.adjustment import FAILURES, with_held_camera, with_unit_depth, without_outliers
from slam_init.bundle.covariances import at_projections, shared_equations
from slam_init.bundle.focal import LensUnknowns, adjust_lens, lens_equations
from slam_init.bundle.problem import BundleProblem
from slam_init.config import MapConfig
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.lens import PULL_FREEDOM, UNKNOWN_K1_SIGMA

#: Standard deviation of k2 of a lens of which nothing is known: wide lenses have one of up to the square of their k1.
#: Class: assumption.
_K2_SIGMA = 0.1
#: The same of the principal point about the centre, over the width of the image: the optical axis of phones is off by a
#: hundredth.
#: Class: assumption, over the width.
_PRINCIPAL_SIGMA = 0.01
#: Factor on the deviations: matches of a scene have errors in common that no region knows, such as repeated texture.
#: Class: assumption.
_OPTIMISM = 2.0
#: Relative deviation of the focal length by what the model of the lens leaves out.
#: Class: measured.
_MODEL_SIGMA = 0.03
#: Parts of the image (columns, rows) whose errors are independent.
#: Class: assumption.
_REGIONS = (4, 3)
#: How often the lens is fitted and further outliers are left out, until the noise changes by less than a twentieth.
_ROUNDS, _NOISE_TOLERANCE = 6, 0.05


@dataclass(frozen=True)
class LensEstimate:
    """The lens by a stretch of video."""

    focal_px: float
    #: Relative standard deviation.
    focal_sigma: float
    #: k1, k1_sigma, k2: The radial distortion in OpenCV's convention.
    k1: float
    k1_sigma: float
    k2: float
    #: Share of the observations in the fit: of landmarks with parallax, and no outliers.
    inliers: float


def fit_lens(problem: BundleProblem, start: Camera, prior: Camera) -> LensEstimate | None:
    """Fit the lens of all views.

    * ``start``: The camera by which the poses of the problem were found, without distortion but k1 and k2.
    * ``prior``: What is known before, with ``focal_sigma``. The principal point is fitted too, and not returned.
    * Returns: None where the views do not determine it.
    """
    config, unknowns = MapConfig(), unknowns_of_lens(start, prior)
    at = np.zeros(len(unknowns.mean))
    try:
        fit = with_held_camera(unknowns.camera_at(at), with_unit_depth(problem), config, poses_known=False)
        noise_px = fit.problem.noise_px(fit.problem.residuals(fit.camera), config)
        for _ in range(_ROUNDS):
            at, fit = adjust_lens(unknowns, at, fit, noise_px)
            fit = without_outliers(fit.camera, fit.problem, (), config)
            before, noise_px = noise_px, fit.problem.noise_px(fit.problem.residuals(fit.camera), config)
            if abs(math.log(noise_px / before)) < _NOISE_TOLERANCE:
                break
        at, fit = adjust_lens(unknowns, at, fit, noise_px)
        variances = _variances(unknowns, at, fit.problem, noise_px)
    except FAILURES:
        return None
    if not np.isfinite(variances).all():
        return None
    pulls = (at - unknowns.mean) / unknowns.sigmas
    sigmas = _OPTIMISM * np.sqrt(variances * (1 + float(pulls @ pulls) / PULL_FREEDOM))
    return LensEstimate(
        focal_px=fit.camera.focal_px,
        focal_sigma=math.hypot(float(sigmas[0]), _MODEL_SIGMA),
        k1=fit.camera.distortion[0],
        k1_sigma=float(sigmas[3]),
        k2=fit.camera.distortion[1],
        inliers=len(fit.problem.views) / len(problem.views),
    )


def unknowns_of_lens(start: Camera, prior: Camera) -> LensUnknowns:
    """The unknowns, relative to the camera of the start."""

    def parameters(camera: Camera) -> Floats:
        return np.array([math.log(camera.focal_px), camera.cx, camera.cy, *(*camera.distortion, 0.0, 0.0)[:2]])

    first, fx, fy = parameters(start), start.fx / start.focal_px, start.fy / start.focal_px

    def camera_at(at: Floats) -> Camera:
        log_focal, cx, cy, k1, k2 = (first + at).tolist()
        focal_px, bent = math.exp(log_focal), (k1, k2, 0.0, 0.0)
        return replace(start, model="radtan", fx=focal_px * fx, fy=focal_px * fy, cx=cx, cy=cy, distortion=bent)

    principal_px = _PRINCIPAL_SIGMA * prior.width
    sigmas = np.array([prior.focal_sigma or 1.0, principal_px, principal_px, UNKNOWN_K1_SIGMA, _K2_SIGMA])
    return LensUnknowns(camera_at, parameters(prior) - first, sigmas)


def _variances(unknowns: LensUnknowns, at: Floats, problem: BundleProblem, noise_px: float) -> Floats:
    """Those (S,) of the unknowns at the optimum, where the scores of the regions sum to what the prior pulls."""
    found = lens_equations(unknowns, at, problem, noise_px)
    covariance = np.linalg.inv(found.information)
    camera = unknowns.camera_at(at)
    projected = at_projections(camera, problem)
    size = np.array([camera.width, camera.height]) / _REGIONS
    place = np.minimum(problem.pixels // size, np.array(_REGIONS) - 1).astype(int) @ (_REGIONS[1], 1)
    _, first = np.unique(problem.landmarks, return_index=True)
    regions = place[first][problem.landmarks]
    scattered = np.zeros(len(at))
    for region in np.unique(regions):
        part = regions == region
        of_part = shared_equations(camera, projected.keep(part), noise_px, problem.keep(part), fields=False)
        score = of_part.gradient + found.follows.T @ of_part.scores.sum(axis=0)
        scattered += (covariance @ score) ** 2
    return np.asarray(np.maximum(np.diag(covariance), scattered))
