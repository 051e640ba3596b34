"""Bundle adjustment of the initial map, from the first estimate to the final map.

Recipe: minimize with a robust kernel (Cauchy), remove the outliers, then minimize the least-squares error in the full
model of the camera. Landmarks whose depths are unknown by the covariance of the optimum are left out, and the rest is
minimized again. The map is scaled so that the median depth of the landmarks in the first view is 1. The covariances
know that the lens is not exact (:mod:`slam_init.bundle.covariances`), and that errors are not independent
(:mod:`slam_init.bundle.shared_errors`).

A point with one view, a NaN and a point behind a camera are checked here. A failure is returned as a value with its
cause.

Focal length: held as stated, or with ``refine_focal`` an unknown. Then everything else is adjusted with a held camera,
by the recipe above, and Newton's method in the focal length goes on from there (:mod:`slam_init.bundle.focal`).

A lens for which gtsam has no calibration (:mod:`slam_init.bundle.virtual_cameras`) keeps the focal length that the
window estimated.

The two-view stage comes before bundle adjustment. Its bearings are always those of the stated camera.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam_init.bundle.covariances import (
    LENS,
    ErrorModel,
    MapCovariances,
    at_projections,
    covariances,
    lens_prior,
)
from slam_init.bundle.focal import adjust_focal, camera_with_focal_factor
from slam_init.bundle.graph import GraphRecipe
from slam_init.bundle.least_squares import fit_points, minimize, with_lenses
from slam_init.bundle.problem import (
    BundleFailure,
    BundleFit,
    BundleProblem,
    BundleSolution,
    PosePrior,
    min_parallax_rad,
)
from slam_init.bundle.shared_errors import error_model
from slam_init.bundle.virtual_cameras import needs_virtual_cameras
from slam_init.config import MapConfig
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.initial_map import ScaleUncertainty
from slam_init.types.lens import LensPrior

#: If the estimated noise is this many times the expected one, the tracks are not those of one rigid scene.
_WORST_NOISE = 10.0
#: Levenberg-Marquardt steps in least squares. From poses that are known, four steps reach the optimum where the
#: landmarks determine it. Where they do not, as on a plane with little parallax, more steps only move the poses away.
_ITERATIONS, _FEW_ITERATIONS = 15, 6
#: The tracks are weighed against a prior of the poses until their stated noise changes by less, at most so often.
_WEIGHED, _WEIGHING_ROUNDS = 0.1, 4
#: Four coordinates in two views leave one residual that tests a landmark. Where the poses follow the landmark so far
#: that half of its residual is gone, it decides about them and nothing tests it. An outlier near its epipolar line has
#: such a place: a large parallax. Of 80 simulated maps with two views and outliers, 11 had a landmark with a leverage
#: above 0.5 that was an outlier (directions off by 2 to 7 degrees), and 2 one that was right.
_LARGEST_LEVERAGE = 0.5


class _UnsolvableError(Exception):
    """The observations do not determine all unknowns; the view that sees too few landmarks, where this is the cause."""

    def __init__(self, cause: str, frame: int | None = None) -> None:
        super().__init__(cause)
        self.frame = frame


#: What ends an adjustment: too few observations, and how gtsam and numpy report singular systems.
FAILURES = (_UnsolvableError, RuntimeError, np.linalg.LinAlgError)


def adjust(
    camera: Camera,
    problem: BundleProblem,
    config: MapConfig,
    focal_factor: float = 1.0,
    *,
    poses_known: bool = False,
) -> BundleSolution | BundleFailure:
    """Adjust poses and landmarks, and the focal length if ``config.refine_focal`` is set; see the module docstring.

    * ``problem``: The first estimate. The world frame is the camera frame of the first view.
    * ``focal_factor``: Where the focal length is adjusted: its first estimate, over the stated one.
    * ``poses_known``: Whether the poses are those of a robust estimate. Only the points are fitted robustly then.
    """
    # Where each observation has a camera of its own, there is no common calibration to adjust: the first estimate of
    # the focal length is held then. It is that of the joint fit of the window.
    held = config.refine_focal and needs_virtual_cameras(camera)
    refined, lens = config.refine_focal and not held, lens_prior(camera, config)
    try:
        start = with_unit_depth(problem)
        first = camera_with_focal_factor(camera, focal_factor) if config.refine_focal else camera
        fit = with_held_camera(first, start, config, poses_known=poses_known)
        if refined:
            fit = adjust_focal(camera, fit, config)
            fit = fit._replace(problem=with_unit_depth(fit.problem))
        stated = _with_known_depths(_stated(fit, config, lens), config, camera if refined else None)
        if problem.prior is not None:
            stated = _weighed_against_poses(stated, config)
        solution = _solution(stated, start, camera)
    except FAILURES as error:
        # Where the tracks contradict known poses, the recipe for poses that are not known may still find a map.
        return adjust(camera, problem, config, focal_factor) if poses_known else _failure(error)
    focal_sigma = float(np.sqrt(stated.found.lens[0, 0])) * solution.camera.fx / camera.fx if refined else None
    return replace(
        solution,
        focal_factor=solution.camera.fx / camera.fx if config.refine_focal else 1.0,
        focal_factor_sigma=config.focal_sigma if held else focal_sigma,
    )


class _Stated(NamedTuple):
    """A fit, and what its residuals say about it."""

    fit: BundleFit
    #: (M, 2)
    residuals: Floats
    errors: ErrorModel
    found: MapCovariances


def _stated(fit: BundleFit, config: MapConfig, lens: LensPrior) -> _Stated:
    residuals = fit.problem.residuals(fit.camera)
    noise_px = fit.problem.noise_px(residuals, config)
    projected = at_projections(fit.camera, fit.problem)
    errors = error_model(fit.camera, projected, fit.problem, noise_px, lens)
    return _Stated(fit, residuals, errors, covariances(fit.camera, projected, errors))


def _solution(stated: _Stated, start: BundleProblem, expected: Camera) -> BundleSolution:
    """The solution of a fit.

    * ``expected``: The camera that the prior of the lens expects.
    """
    (camera, final, *_), found, errors = stated.fit, stated.found, stated.errors
    variable = errors.lens if errors.lens.sigmas.any() and not needs_virtual_cameras(camera) else None
    depth_sigmas = _depth_sigmas(final, found.in_newest)
    return BundleSolution(
        problem=final,
        before=_same_landmarks(start, final),
        noise_px=errors.noise_px,
        rmse_px=float(np.sqrt(np.mean(np.sum(stated.residuals**2, axis=1)))),
        errors=stated.fit.errors,
        recipe=GraphRecipe(camera, final, errors.noise_of_graph_px, variable, expected),
        overdispersion=errors.overdispersion,
        pose_covariances=found.poses,
        point_covariances=found.points,
        depth_sigmas=depth_sigmas,
        scale_uncertainty=_scale_uncertainty(depth_sigmas, found.stretched),
        seen_covariances=found.by_noise,
        seen_depth_sigmas=_depth_sigmas(final, found.by_noise),
        unknown_depths=stated.fit.unknown_depths,
        camera=camera,
    )


def solution_of(camera: Camera, problem: BundleProblem, config: MapConfig) -> BundleSolution | BundleFailure:
    """The map of a problem that is at its optimum, in its own frame and unit, with its graph and covariances."""
    lens = lens_prior(camera, config)
    try:
        return _solution(_stated(BundleFit(camera, problem, ()), config, lens), problem, camera)
    except FAILURES as error:
        return _failure(error)


def _failure(error: Exception) -> BundleFailure:
    return BundleFailure(" ".join(str(error).split())[:160], getattr(error, "frame", None))


def restated(solution: BundleSolution, prior: PosePrior, config: MapConfig) -> BundleSolution | BundleFailure:
    """The same map with another prior of its poses, in its graph and its covariances."""
    again = solution_of(solution.camera, replace(solution.problem, prior=prior), config)
    if isinstance(again, BundleFailure):
        return again
    return replace(
        again,
        before=solution.before,
        errors=solution.errors,
        unknown_depths=solution.unknown_depths,
        focal_factor=solution.focal_factor,
        focal_factor_sigma=solution.focal_factor_sigma,
    )


def _with_known_depths(stated: _Stated, config: MapConfig, expected: Camera | None) -> _Stated:
    """Leave the landmarks out whose depths are unknown, or that nothing tests, and minimize the rest.

    Where too few landmarks would be left to solve for the poses, all of them stay.

    * ``expected``: Where the focal length is adjusted: the stated camera.
    """
    while True:
        fit, problem = stated.fit, stated.fit.problem
        known: Bools = np.asarray(_depth_sigmas(problem, stated.found.by_noise) <= config.max_depth_sigma)
        known &= stated.found.leverage <= _LARGEST_LEVERAGE
        if known.all():
            return stated
        try:
            rest = _solvable(problem.keep(known[problem.landmarks]))
            fewer = _settled(fit.camera, rest, stated.errors.noise_px, _FEW_ITERATIONS)
        except _UnsolvableError:
            return stated
        dropped = len(problem.points) - len(fewer.problem.points)
        fit = fewer._replace(errors=(*fit.errors, *fewer.errors), unknown_depths=fit.unknown_depths + dropped)
        if expected is not None:
            fit = adjust_focal(expected, fit, config)
        stated = _stated(fit, config, stated.errors.lens)


def _weighed_against_poses(stated: _Stated, config: MapConfig) -> _Stated:
    """Weigh the tracks against the prior of the poses by the noise that the graph states.

    The errors of the tracks are not independent. Their overdispersion changes no optimum of the tracks alone, but with
    the noise of single tracks a hundred of them would outweigh the prior by what they share.
    """
    for _ in range(_WEIGHING_ROUNDS):
        fit, noise_px = stated.fit, stated.errors.noise_of_graph_px
        try:
            settled = _settled(fit.camera, fit.problem, noise_px, _ITERATIONS)
        except _UnsolvableError:
            break
        fit = settled._replace(errors=(*fit.errors, *settled.errors), unknown_depths=fit.unknown_depths)
        stated = _stated(fit, config, stated.errors.lens)
        if abs(stated.errors.noise_of_graph_px / noise_px - 1) < _WEIGHED:
            break
    return stated


def _depth_sigmas(problem: BundleProblem, in_newest: Floats) -> Floats:
    """Relative standard deviations (L,) of the distances of the points from the newest camera."""
    seen = problem.world_from_cam[-1].inverse().apply(problem.points)
    squares = np.sum(seen**2, axis=1)
    return np.asarray(np.sqrt(np.einsum("li,lij,lj->l", seen, in_newest, seen)) / squares)


def _scale_uncertainty(depth_sigmas: Floats, stretched: Floats) -> ScaleUncertainty:
    """The error of the weighted mean of the distances.

    Shapes: ``depth_sigmas`` (L,), ``stretched`` (L, C).

    * ``stretched``: By the causes that landmarks share, those of the lens last.
    """
    weights = 1 / np.maximum(depth_sigmas, 1e-12) ** 2
    weights /= weights.sum()
    shared = weights @ stretched
    own = np.maximum(depth_sigmas**2 - np.sum(stretched**2, axis=1), 0.0)
    return ScaleUncertainty(float(np.sqrt(np.sum(shared[:-LENS] ** 2) + weights**2 @ own)), shared[-LENS:])


def with_held_camera(camera: Camera, start: BundleProblem, config: MapConfig, *, poses_known: bool) -> BundleFit:
    """Adjust poses and landmarks: with a robust kernel, then without outliers in least squares.

    * ``poses_known``: Whether the poses are those of a robust estimate. Only the points are fitted robustly then.
    * Returns: The fit has no outliers, and its median depth in the first view is 1.
    """
    start = with_lenses(camera, start)
    if poses_known:
        points = fit_points(start, config.noise_px)
        return without_outliers(camera, points, (_rms_px(start, camera),), config, _FEW_ITERATIONS)
    if not (np.isfinite(start.points).all() and np.isfinite(start.pixels).all()):
        raise _UnsolvableError("a coordinate of a landmark or of a pixel is not finite")
    ahead = _solvable(_in_front(start, camera))
    # The robust stage only has to identify the outliers; the least-squares stage reaches the full precision.
    robust, errors = minimize(ahead, config.noise_px, iterations=8, tolerance=1e-3, robust=True)
    return without_outliers(camera, robust, tuple(errors), config)


def without_outliers(
    camera: Camera, robust: BundleProblem, errors: tuple[float, ...], config: MapConfig, iterations: int = _ITERATIONS
) -> BundleFit:
    """The least-squares fit without the outliers of a fit."""
    residuals = robust.residuals(camera)
    noise_px = robust.robust_noise_px(residuals, config)
    if noise_px > _WORST_NOISE * config.noise_px:
        raise _UnsolvableError(f"no map fits the tracks: the residuals are {noise_px:.0f} px")
    # The residual of a landmark behind a camera is NaN, which is not an inlier.
    inlying: Bools = np.asarray(np.linalg.norm(residuals, axis=1) < config.outlier_sigmas * noise_px)
    cleaned = robust.keep(inlying)
    # The parallax is checked in the remaining views: a landmark may have lost the view that gave it its parallax.
    certain: Bools = np.asarray(cleaned.parallax_rad() > min_parallax_rad(camera, noise_px, config))
    cleaned = _solvable(cleaned.keep(certain[cleaned.landmarks]))
    settled = _settled(camera, cleaned, noise_px, iterations)
    return settled._replace(errors=(*errors, *settled.errors))


def _settled(camera: Camera, problem: BundleProblem, noise_px: float, iterations: int) -> BundleFit:
    """The optimum in least squares, without the points that it moved behind a camera; its median depth is 1."""
    polished, errors = minimize(problem, noise_px, iterations=iterations, tolerance=1e-5)
    return BundleFit(camera, _solvable(_in_front(with_unit_depth(polished), camera)), tuple(errors))


def _in_front(problem: BundleProblem, camera: Camera) -> BundleProblem:
    """The problem without the observations of points that the camera does not see."""
    seen: Bools = np.asarray(np.isfinite(problem.residuals(camera)).all(axis=1))
    return problem.keep(seen)


def _rms_px(problem: BundleProblem, camera: Camera) -> float:
    squares = np.sum(problem.residuals(camera) ** 2, axis=1)
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else np.inf


def with_unit_depth(problem: BundleProblem) -> BundleProblem:
    """The problem with a median depth of 1 in the first view."""
    depths = problem.world_from_cam[0].inverse().apply(problem.points)[:, 2]
    depths = depths[np.isfinite(depths) & (depths > 0)]
    if not len(depths):
        raise _UnsolvableError("no landmark lies in front of the first camera")
    return problem.scaled(1 / float(np.median(depths)))


def _solvable(problem: BundleProblem) -> BundleProblem:
    """The problem, whose observations determine all unknowns."""
    seen = np.bincount(problem.views, minlength=len(problem.frames))
    if len(problem.points) < 6:
        raise _UnsolvableError(f"only {len(problem.points)} landmarks remain after the removal of outliers")
    if seen.min() < 6:
        weakest = problem.frames[int(np.argmin(seen))]
        cause = f"frame {weakest} sees only {int(seen.min())} landmarks after the removal of outliers"
        raise _UnsolvableError(cause, weakest)
    return problem


def _same_landmarks(start: BundleProblem, final: BundleProblem) -> BundleProblem:
    """The first estimate, reduced to the landmarks of the final map. Its median depth in the first view was 1."""
    points = start.points[np.isin(start.track_ids, final.track_ids)]
    return replace(final, world_from_cam=start.world_from_cam, points=points)
