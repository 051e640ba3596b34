"""Adjusts the focal length, an unknown that all views share and that has a prior, by Newton's method.

fx and fy keep their ratio, and all other parameters of the camera are held. The images of a camera that does not rotate
do not determine the focal length: a longer lens sees a scene that is stretched along the optical axis in the same way.
In this case the result is that of the prior, and the standard deviation is that of the prior as well.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam_init.bundle.covariances import SharedErrors, inverse_of_poses, shared_equations
from slam_init.bundle.least_squares import Equations, minimize, stepped, with_lenses
from slam_init.bundle.lens import at_projections, lens_derivatives, residuals_of
from slam_init.bundle.noise import least_squares_noise
from slam_init.bundle.problem import BundleFit, BundleProblem
from slam_init.bundle.reprojection import is_undistorted_first
from slam_init.config import MapConfig
from slam_init.errors import CalibrationError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.lenses.lens import scaled_coefficients

#: Newton's method ends after a step that lowers the error by less than this share. With a thousand observations this
#: is 0.01, a seventh of a standard deviation of the focal length, and the next step would be much smaller.
_NEWTON_TOLERANCE, _NEWTON_STEPS = 1e-5, 10
#: Shares of a step that are tried in this order. The full step is mostly right; shorter ones are for wrong maps.
_STEP_SHARES = (1.0, 0.5, 0.25, 0.1)
#: Range of the focal length over the stated one. A larger error cannot be corrected by adjustment.
_FACTORS = (0.1, 10.0)


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
    camera, problem, errors, _ = fit
    noise_px = least_squares_noise(problem, problem.residuals(camera), config)
    factor, rms_px = camera.fx / stated.fx, minimize(problem, noise_px, iterations=0, tolerance=0.0)[1][-1]

    def error_of(factor: float, rms_px: float) -> float:
        return 0.5 * len(problem.views) * (rms_px / noise_px) ** 2 + 0.5 * ((factor - 1) / config.focal_sigma) ** 2

    error = error_of(factor, rms_px)
    for _ in range(_NEWTON_STEPS):
        try:
            step = _newton_step(camera, problem, noise_px, factor, config.focal_sigma)
        except RuntimeError:  # the poses are not determined
            break
        for share in _STEP_SHARES:
            tried_factor = factor * math.exp(share * step.log_scale)
            if not _FACTORS[0] < tried_factor < _FACTORS[1]:
                continue
            try:
                tried = camera_with_focal_factor(stated, tried_factor)
                moved = stepped(problem, step.equations, share * step.poses, share * step.of_points)
                polished, more = minimize(with_lenses(tried, moved), noise_px, iterations=15, tolerance=1e-6)
            except (RuntimeError, CalibrationError):  # the step is too long: try a shorter one
                continue
            new = error_of(tried_factor, more[-1])
            if new < error and np.isfinite(polished.residuals(tried)).all():
                break
        else:
            break
        gain, error = error - new, new
        camera, problem, factor = tried, polished, tried_factor
        errors = (*errors, *more)
        if gain < _NEWTON_TOLERANCE * error:
            break
    return fit._replace(camera=camera, problem=problem, errors=errors)


class _NewtonStep(NamedTuple):
    """A step of the logarithm of the focal length, and what follows it."""

    log_scale: float
    #: (6 K,)
    poses: Floats
    #: (3 L,) Of the points, over their roots.
    of_points: Floats
    equations: Equations


def _newton_step(camera: Camera, problem: BundleProblem, noise_px: float, factor: float, sigma: float) -> _NewtonStep:
    """The step in all unknowns at the optimum of poses and points, which follow the focal length."""
    projected = at_projections(camera, problem)
    lens = lens_derivatives(camera, projected)
    found = shared_equations(projected, noise_px, SharedErrors.of_lens(lens), residuals_of(projected, problem))
    coupling, of_points = found.coupling[:, 0], found.of_points[:, :, 0].ravel()
    follows = -inverse_of_poses(found.equations.information) @ coupling
    information = float(found.own[:, 0, 0].sum() - of_points @ of_points + coupling @ follows)
    gradient = float(found.gradient[0] + follows @ found.scores.sum(axis=0))
    # The prior is that of the factor, which a step of its logarithm moves in proportion.
    information += (factor / sigma) ** 2
    gradient += (factor - 1) * factor / sigma**2
    step = -gradient / information
    return _NewtonStep(step, step * follows, step * of_points, found.equations)
