"""Adjusts the focal length, an unknown that all views share and that has a prior, by Newton's method.

fx and fy keep their ratio, and all other parameters of the camera are held. The images of a camera that does not rotate
do not determine the focal length: a longer lens sees a scene that is stretched along the optical axis in the same way.
In this case the result is that of the prior, and the standard deviation is that of the prior as well.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from quest.descent import descend
from slam_init.bundle.covariances import at_projections, inverse_of_poses, shared_equations
from slam_init.bundle.least_squares import minimize, stepped, with_lenses
from slam_init.bundle.problem import BundleFit, BundleProblem
from slam_init.bundle.reprojection import is_undistorted_first
from slam_init.config import MapConfig
from slam_init.errors import CalibrationError
from slam_init.lenses.lens import scaled_coefficients
from slam_init.types.camera import Camera

#: Newton's method ends after a step that lowers the error by less than this share. With a thousand observations this
#: is 0.01, a seventh of a standard deviation of the focal length, and the next step would be much smaller.
_LEAST_SHARE, _STEPS = 1e-5, 10
#: Damping of the steps, over the information about the focal length. Nearly the full step is mostly right; shorter
#: ones, down to a tenth, are for wrong maps.
_DAMPING, _MOST_DAMPING = 0.01, 10.0


def camera_with_focal_factor(camera: Camera, factor: float) -> Camera:
    """Multiply the focal lengths of a camera by a factor, as the adjustment does.

    Principal point and distortion coefficients are held, except for a camera with k3 or a rational part. Such a camera
    is adjusted on undistorted pixels, which the factor must not change. Therefore its coefficients are converted to
    units of the new focal length.
    """
    fx, fy = factor * camera.fx, factor * camera.fy
    if not is_undistorted_first(camera):
        return replace(camera, fx=fx, fy=fy)
    distortion = scaled_coefficients(camera.model, camera.distortion, factor)
    return replace(camera, fx=fx, fy=fy, distortion=distortion)


def adjust_focal(stated: Camera, fit: BundleFit, config: MapConfig) -> BundleFit:
    """Adjust the focal length by Newton's method. Poses and landmarks are optimized again after each step.

    Adjusting all unknowns at once converges very slowly: 5 % more focal length needs 5 % less rotation and 5 % less
    width of the points, and the error of second order (5 % squared) is already a pixel.

    * ``config``: ``focal_sigma`` is the standard deviation of the stated focal length.
    * Returns: With the adjusted camera; the given fit if no step lowers the error.
    """
    noise_px = fit.problem.noise_px(fit.problem.residuals(fit.camera), config)

    def error_of(camera: Camera, rms_px: float) -> float:
        pull = (camera.fx / stated.fx - 1) / config.focal_sigma
        return 0.5 * len(fit.problem.views) * (rms_px / noise_px) ** 2 + 0.5 * pull**2

    def step(at: BundleFit, damping: float) -> tuple[BundleFit, float]:
        factor, share = at.camera.fx / stated.fx, 1 / (1 + damping)
        try:
            log_scale, moved = _newton_step(at, noise_px, factor, config.focal_sigma, share)
            camera = camera_with_focal_factor(stated, factor * math.exp(log_scale))
            problem, more = minimize(with_lenses(camera, moved), noise_px, iterations=15, tolerance=1e-6)
        except (RuntimeError, CalibrationError):  # the poses are not determined, or the step is too long
            return at, math.inf
        if not np.isfinite(problem.residuals(camera)).all():
            return at, math.inf
        return at._replace(camera=camera, problem=problem, errors=(*at.errors, *more)), error_of(camera, more[-1])

    error = error_of(fit.camera, minimize(fit.problem, noise_px, iterations=0, tolerance=0.0)[1][-1])
    adjusted, _ = descend(
        fit, error, step, steps=_STEPS, damping=_DAMPING, most_damping=_MOST_DAMPING,
        least_decrease=_LEAST_SHARE * error,
    )  # fmt: skip
    return adjusted


def _newton_step(
    fit: BundleFit, noise_px: float, factor: float, sigma: float, share: float
) -> tuple[float, BundleProblem]:
    """A share of the step of the logarithm of the focal length, and the poses and points, which follow it.

    They are at the optimum of the focal length that the fit has, ``factor`` times the stated one.
    """
    camera, problem = fit.camera, fit.problem
    found = shared_equations(camera, at_projections(camera, problem), noise_px, problem)
    coupling, of_points = found.coupling[:, 0], found.of_points[:, :, 0].ravel()
    follows = -inverse_of_poses(found.equations.information) @ coupling
    information = float(found.own[:, 0, 0].sum() - of_points @ of_points + coupling @ follows)
    gradient = float(found.gradient[0] + follows @ found.scores.sum(axis=0))
    # The prior is that of the factor, which a step of its logarithm moves in proportion.
    information += (factor / sigma) ** 2
    gradient += (factor - 1) * factor / sigma**2
    step = -gradient / information
    moved = stepped(problem, found.equations, share * (step * follows), share * (step * of_points))
    return share * step, moved
