"""The focal length as an unknown of bundle adjustment that all views share, with a prior: by Newton's method.

fx and fy keep their ratio, and all else of the camera is held. A camera that does not turn cannot tell the focal length
(stretch the scene along the optical axis, and a longer lens shows the same), so that the prior decides there, and the
standard deviation says so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.bundle.graph import build_graph, is_undistorted_first, optimize, read_focal_factor, read_problem
from slam_init.bundle.noise import least_squares_noise
from slam_init.bundle.problem import BundleFit, FocalPrior
from slam_init.config import MapConfig
from slam_init.errors import CalibrationError
from slam_init.types.camera import Camera

__all__ = ["adjust_focal", "camera_with_focal_factor"]

#: Newton's steps in the focal length end after one that lowers the error by less than this share: of a thousand
#: observations by 0.01, a seventh of a standard deviation, and the next one would be smaller by far.
_NEWTON_TOLERANCE, _NEWTON_STEPS = 1e-5, 10
#: Tried shares of a step. A full one is mostly right; shorter ones are for maps that are wrong.
_STEP_SHARES = (1.0, 0.5, 0.25, 0.1)
#: A focal length that is wrong by more is no matter of adjustment.
_FACTORS = (0.1, 10.0)


def camera_with_focal_factor(camera: Camera, factor: float) -> Camera:
    """The camera with its focal lengths times a factor, as the adjustment changes them.

    Principal point and distortion coefficients are held. A camera with k3 is adjusted on undistorted pixels, which the
    factor must not change: there the coefficients belong to the image, and in units of the new focal length they are
    others.
    """
    fx, fy = factor * camera.fx, factor * camera.fy
    if not is_undistorted_first(camera):
        return replace(camera, fx=fx, fy=fy)
    powers = (2, 4, 1, 1, 6)  # of k1, k2, p1, p2, k3: each with the degree of its term, less one
    distortion = tuple(k * factor**power for k, power in zip(camera.distortion, powers, strict=True))
    return replace(camera, fx=fx, fy=fy, distortion=distortion)


def adjust_focal(prior: FocalPrior, fit: BundleFit, config: MapConfig) -> BundleFit:
    """Newton's method in the focal length, all else at its optimum for it: before, and again after each step.

    Everything at once would creep: a twentieth more of focal length is a twentieth less of rotation and of the points'
    width, and the square of a twentieth is a pixel. Nor is it left to gtsam's Levenberg-Marquardt: to a factor with a
    variable calibration a landmark behind the camera costs nothing, so that it would be pushed there.
    """
    camera, problem, errors = fit
    noise_px = least_squares_noise(problem, problem.residuals(camera), config)
    graph, values = build_graph(camera, problem, noise_px, robust=False, prior=prior)
    error = float(graph.error(values))
    for _ in range(_NEWTON_STEPS):
        try:
            # The step of all unknowns: its part in the focal length is Newton's.
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
                polished, more = optimize(
                    tried, read_problem(moved, problem), noise_px, robust=False, iterations=15, tolerance=1e-6
                )
            except (RuntimeError, CalibrationError):  # too far: a shorter step, or the last fit stands
                continue
            # Asked first: gtsam tells of a landmark behind a camera of variable calibration on the standard output.
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
    return BundleFit(camera, problem, errors)
