"""Bundle adjustment of the initial map, from the first guess to the map that is handed over.

Recipe: a robust kernel first (Cauchy), then the outliers out, then a least-squares polish on the camera's own model.
The map is scaled so that the median depth of the landmarks in the first view is 1.

gtsam's Levenberg-Marquardt does not complain about a point with one view, a NaN, or a point behind a camera: these
are checked here, and a failure is a value with its cause.

Focal length: held as stated, or with ``refine_focal`` an unknown. It is adjusted in rounds: everything else first, the
camera held, with the robust kernel and without outliers; from there by Newton's method in the focal length
(:mod:`slam_init.bundle.focal`); then anew with the new camera, under which other observations may be outliers. The
two-view stage goes before: its bearings are those of the stated camera, whatever is found here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.bundle.focal import adjust_focal
from slam_init.bundle.graph import GAUGE, build_graph, marginal_covariances, optimize
from slam_init.bundle.noise import estimate_noise, least_squares_noise, min_parallax_rad
from slam_init.bundle.problem import BundleFailure, BundleFit, BundleProblem, BundleSolution, FocalPrior
from slam_init.config import MapConfig
from slam_init.types.arrays import Bools
from slam_init.types.camera import Camera

__all__ = ["adjust"]

#: Tracks whose residuals are this many times the expected noise are no tracks of one rigid scene.
_WORST_NOISE = 10.0
#: Rounds end where the focal length moves by less: 0.3 px at the border of the image, no other outliers.
_FOCAL_TOLERANCE, _FOCAL_ROUNDS = 1e-3, 5


def adjust(camera: Camera, problem: BundleProblem, config: MapConfig) -> BundleSolution | BundleFailure:
    """Adjust poses and landmarks, and the focal length where the configuration says so; see the module docstring.

    Parameters
    ----------
    camera : Camera
        As stated.
    problem : BundleProblem
        World frame = camera frame of the first view.
    config : MapConfig
    """
    start = _scale_to_median_depth(problem)
    if start is None:
        return BundleFailure("no landmark lies in front of the first camera")
    prior = FocalPrior(camera, config.focal_sigma) if config.refine_focal else None
    try:
        fit = _fit(camera, start, config)
        if prior is not None and isinstance(fit, BundleFit):
            fit = _fit_focal(prior, start, fit, config)
        if isinstance(fit, BundleFailure):
            return fit
        final, camera = fit.problem, fit.camera
        residuals = final.residuals(camera)
        noise_px = least_squares_noise(final, residuals, config)
        graph, values = build_graph(camera, final, noise_px, robust=False, prior=prior)
        covariances, focal_variance = marginal_covariances(graph, values, final.frames, prior)
    except RuntimeError as error:  # how gtsam reports singular systems and cheirality
        return BundleFailure(" ".join(str(error).split())[:160])
    return BundleSolution(
        problem=final,
        before=_same_landmarks(start, final),
        noise_px=noise_px,
        rmse_px=float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))),
        errors=fit.errors,
        graph=graph,
        values=values,
        pose_covariances=covariances,
        camera=camera,
        gauge=GAUGE,
        focal_factor=1.0 if prior is None else camera.fx / prior.camera.fx,
        focal_factor_sigma=None if prior is None else float(np.sqrt(focal_variance)) / prior.camera.fx,
    )


def _fit(camera: Camera, start: BundleProblem, config: MapConfig) -> BundleFit | BundleFailure:
    """Robust, then without outliers in least squares, the camera held."""
    # The robust stage only has to tell the outliers: the last digits are left to the polish.
    robust, errors = optimize(camera, start, config.noise_px, robust=True, iterations=8, tolerance=1e-3)
    residuals = robust.residuals(camera)
    noise_px = estimate_noise(robust, residuals, config)
    if noise_px > _WORST_NOISE * config.noise_px:
        return BundleFailure(f"the tracks disagree with every map by {noise_px:.0f} px")
    # NaN, behind a camera, is no inlier.
    inlying: Bools = np.asarray(np.linalg.norm(residuals, axis=1) < config.outlier_sigmas * noise_px)
    cleaned = robust.keep(inlying)
    # Asked of the views that are left: a landmark may have lost the one that gave it its parallax.
    certain: Bools = np.asarray(cleaned.parallax_rad() > min_parallax_rad(camera, noise_px, config))
    cleaned = cleaned.keep(certain[cleaned.landmarks])
    if (failure := _cannot_be_solved(cleaned)) is not None:
        return failure
    polished, more = optimize(camera, cleaned, noise_px, robust=False, iterations=15, tolerance=1e-5)
    final = _scale_to_median_depth(polished)
    if final is None:
        return BundleFailure("no landmark lies in front of the first camera")
    before: Bools = np.asarray(np.isfinite(final.residuals(camera)).all(axis=1))
    if not before.all():
        final = final.keep(before)
        if (failure := _cannot_be_solved(final)) is not None:
            return failure
    return BundleFit(camera, final, (*errors, *more))


def _fit_focal(prior: FocalPrior, start: BundleProblem, fit: BundleFit, config: MapConfig) -> BundleFit | BundleFailure:
    """The focal length as well, from a fit with the stated one: see the module docstring."""
    joint = adjust_focal(prior, fit, config)
    for _ in range(_FOCAL_ROUNDS):
        if abs(joint.camera.fx / fit.camera.fx - 1) < _FOCAL_TOLERANCE:
            break
        try:
            again = _fit(joint.camera, start, config)
        except RuntimeError:  # as in adjust
            break
        if isinstance(again, BundleFailure):
            break  # the last one stands
        fit = again._replace(errors=(*joint.errors, *again.errors))
        joint = adjust_focal(prior, fit, config)
    final = _scale_to_median_depth(joint.problem)
    if final is None:
        return BundleFailure("no landmark lies in front of the first camera")
    return joint._replace(problem=final)


def _scale_to_median_depth(problem: BundleProblem) -> BundleProblem | None:
    depths = problem.world_from_cam[0].inverse().apply(problem.points)[:, 2]
    depths = depths[np.isfinite(depths) & (depths > 0)]
    return problem.scaled(1 / float(np.median(depths))) if len(depths) else None


def _cannot_be_solved(problem: BundleProblem) -> BundleFailure | None:
    """A graph that has more unknowns than it can fix, which gtsam would not say."""
    seen = np.bincount(problem.views, minlength=len(problem.frames))
    if len(problem.points) < 6:
        return BundleFailure(f"only {len(problem.points)} landmarks are left after the outliers are out")
    if seen.min() < 6:
        weakest = problem.frames[int(np.argmin(seen))]
        return BundleFailure(f"frame {weakest} sees only {int(seen.min())} landmarks after the outliers are out")
    return None


def _same_landmarks(start: BundleProblem, final: BundleProblem) -> BundleProblem:
    """The start, reduced to the landmarks of the final map and brought to its scale by the median depth ratio."""
    position = {track: i for i, track in enumerate(start.track_ids.tolist())}
    rows = np.array([position[track] for track in final.track_ids.tolist()], np.int64)
    points = start.points[rows]
    return replace(final, world_from_cam=start.world_from_cam, points=points)
