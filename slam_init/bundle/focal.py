"""Adjusts the lens, whose unknowns all views share and have a prior, by Newton's method.

A map without a calibration has one such unknown, the focal length. fx and fy keep their ratio, and the distortion is
held (:func:`camera_with_focal_factor`). The images of a camera that does not rotate do not determine the focal length:
a longer lens sees a scene that is stretched along the optical axis in the same way. In this case the result is that of
the prior, and the standard deviation is that of the prior as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from quest.descent import descend
from slam_init.bundle.covariances import SharedEquations, at_projections, inverse_of_poses, shared_equations
from slam_init.bundle.least_squares import minimize, stepped, with_lenses
from slam_init.bundle.problem import BundleFit, BundleProblem
from slam_init.bundle.reprojection import is_undistorted_first
from slam_init.config import MapConfig
from slam_init.errors import CalibrationError
from slam_init.lenses.lens import scaled_coefficients
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera

#: Newton's method ends after a step that lowers the error by less than this share. With a thousand observations this
#: is 0.01, a seventh of a standard deviation of the focal length, and the next step would be much smaller.
_LEAST_SHARE, _STEPS = 1e-5, 10
#: Damping of the steps, over the information about the lens. Nearly the full step is mostly right; shorter ones, down
#: to a hundredth, are for wrong maps and for lenses that bend strongly.
_DAMPING, _MOST_DAMPING = 0.01, 100.0
#: The unknowns of a lens, and the fit at the optimum for this lens.
_State: TypeAlias = tuple[Floats, BundleFit]


class LensUnknowns(NamedTuple):
    """Unknowns that make a camera: the logarithm of the focal length, or besides principal point (pixels), k1 and k2.

    There are S of them, 1 or 5, in the order of the columns of :class:`slam_init.bundle.covariances.SharedEquations`.
    """

    camera_at: Callable[[Floats], Camera]
    #: mean, sigmas: (S,) Of the prior.
    mean: Floats
    sigmas: Floats


class LensEquations(NamedTuple):
    """The equations of the unknowns of a lens, with the prior, poses and points eliminated."""

    #: information, gradient: (S, S) and (S,)
    information: Floats
    gradient: Floats
    #: (6 K, S) How the poses follow the lens.
    follows: Floats
    shared: SharedEquations


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
    """Adjust the focal length. Poses and landmarks are optimized again after each step.

    * ``config``: ``focal_sigma`` is the standard deviation of the stated focal length.
    * Returns: With the adjusted camera; the given fit if no step lowers the error.
    """
    noise_px = fit.problem.noise_px(fit.problem.residuals(fit.camera), config)
    unknowns = LensUnknowns(
        lambda at: camera_with_focal_factor(stated, math.exp(at[0])), np.zeros(1), np.array([config.focal_sigma])
    )
    return adjust_lens(unknowns, np.log([fit.camera.fx / stated.fx]), fit, noise_px)[1]


def adjust_lens(unknowns: LensUnknowns, start: Floats, fit: BundleFit, noise_px: float) -> _State:
    """Adjust the unknowns of a lens. Poses and landmarks are optimized again after each step.

    Adjusting all unknowns at once converges very slowly: 5 % more focal length needs 5 % less rotation and 5 % less
    width of the points, and the error of second order (5 % squared) is already a pixel.

    * ``start``: (S,) The unknowns of the camera of the fit.
    * Returns: The unknowns (S,), and the fit with their camera; what was given if no step lowers the error.
    """

    def error_of(at: Floats, rms_px: float) -> float:
        pulls = (at - unknowns.mean) / unknowns.sigmas
        return 0.5 * len(fit.problem.views) * (rms_px / noise_px) ** 2 + 0.5 * float(pulls @ pulls)

    def step(state: _State, damping: float) -> tuple[_State, float]:
        at, before = state
        try:
            found = lens_equations(unknowns, at, before.problem, noise_px)
            found.information[np.diag_indices(len(at))] *= 1 + damping
            lens = -np.linalg.solve(found.information, found.gradient)
            camera, of_points = unknowns.camera_at(at + lens), found.shared.of_points[:, :, : len(at)] @ lens
            moved = stepped(before.problem, found.shared.equations, found.follows @ lens, of_points.ravel())
            problem, more = minimize(with_lenses(camera, moved), noise_px, iterations=15, tolerance=1e-6)
        except (RuntimeError, CalibrationError, np.linalg.LinAlgError):
            return state, math.inf  # the poses are not determined, or the step is too long
        if not (np.isfinite(problem.residuals(camera)).all() and np.isfinite(problem.virtual).all()):
            return state, math.inf  # the lens does not see a landmark or a pixel, whose error would be left out
        after = before._replace(camera=camera, problem=problem, errors=(*before.errors, *more))
        return (at + lens, after), error_of(at + lens, more[-1])

    error = error_of(start, minimize(fit.problem, noise_px, iterations=0, tolerance=0.0)[1][-1])
    return descend(
        (start, fit), error, step, steps=_STEPS, damping=_DAMPING, most_damping=_MOST_DAMPING,
        least_decrease=_LEAST_SHARE * error,
    )[0]  # fmt: skip


def lens_equations(unknowns: LensUnknowns, at: Floats, problem: BundleProblem, noise_px: float) -> LensEquations:
    """The equations at some unknowns (S,), whose camera has the given problem with its lenses."""
    camera, size = unknowns.camera_at(at), len(at)
    found = shared_equations(camera, at_projections(camera, problem), noise_px, problem, fields=False)
    follows = -inverse_of_poses(found.equations.information) @ found.coupling[:, :size]
    of_points, weights = found.of_points[:, :, :size].reshape(-1, size), 1 / unknowns.sigmas**2
    # The tracks pull the poses, and so does what is known of the poses besides.
    of_poses = found.scores.sum(axis=0) + found.equations.gradient
    information = found.own.sum(axis=0)[:size, :size] - of_points.T @ of_points
    return LensEquations(
        information + found.coupling[:, :size].T @ follows + np.diag(weights),
        found.gradient[:size] + follows.T @ of_poses + weights * (at - unknowns.mean),
        follows,
        found,
    )
