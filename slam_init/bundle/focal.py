"""Adjusts the focal length, an unknown that all views share and that has a prior, by Newton's method.

fx and fy keep their ratio, and all other parameters of the camera are held. The images of a camera that does not rotate
do not determine the focal length: a longer lens sees a scene that is stretched along the optical axis in the same way.
In this case the result is that of the prior, and the standard deviation is that of the prior as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.bundle.graph import build_graph, is_undistorted_first, read_focal_factor, read_problem
from slam_init.bundle.least_squares import minimize, with_lenses
from slam_init.bundle.noise import least_squares_noise
from slam_init.bundle.problem import BundleFit, LensPrior
from slam_init.config import MapConfig
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera
from slam_init.types.lenses.models import scaled_coefficients

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


def adjust_focal(prior: LensPrior, fit: BundleFit, config: MapConfig) -> BundleFit:
    """Adjust the focal length by Newton's method. Poses and landmarks are optimized again after each step.

    Adjusting all unknowns at once converges very slowly: 5 % more focal length needs 5 % less rotation and 5 % less
    width of the points, and the error of second order (5 % squared) is already a pixel. gtsam's Levenberg-Marquardt is
    not used for the focal length: in a factor with a variable calibration a landmark behind the camera has no error, so
    that landmarks would be pushed there.

    * ``prior``: The stated camera, and the standard deviation of its focal length.
    * Returns: With the adjusted camera; the given fit if no step lowers the error.
    """
    camera, problem, errors, _ = fit
    noise_px = least_squares_noise(problem, problem.residuals(camera), config)
    graph, values = build_graph(camera, problem, noise_px, robust=False, prior=prior)
    error = float(graph.error(values))
    for _ in range(_NEWTON_STEPS):
        try:
            # The step in all unknowns; its component in the focal length is the Newton step.
            step = graph.linearize(values).optimize()
        except RuntimeError:  # how gtsam reports singular systems and cheirality
            break
        for share in _STEP_SHARES:
            moved = values.retract(step.scale(share))
            factor = read_focal_factor(prior.camera, moved)
            if not _FACTORS[0] < factor < _FACTORS[1]:
                continue
            try:
                tried = camera_with_focal_factor(prior.camera, factor)
                there = with_lenses(tried, read_problem(moved, problem))
                polished, more = minimize(there, noise_px, iterations=15, tolerance=1e-6)
            except (RuntimeError, CalibrationError):  # the step is too long: try a shorter one
                continue
            # Checked before the graph is evaluated: gtsam prints a message to the standard output for each landmark
            # behind a camera with a variable calibration.
            if not np.isfinite(polished.residuals(tried)).all():
                continue
            graph_there, values_there = build_graph(tried, polished, noise_px, robust=False, prior=prior)
            if (new := float(graph_there.error(values_there))) < error:
                break
        else:
            break
        gain, error = error - new, new
        camera, problem, graph, values = tried, polished, graph_there, values_there
        errors = (*errors, *more)
        if gain < _NEWTON_TOLERANCE * error:
            break
    return fit._replace(camera=camera, problem=problem, errors=errors)
