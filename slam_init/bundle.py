"""Bundle adjustment of the initial map: the only module of the pipeline that imports gtsam.

Recipe: a robust kernel first (Cauchy), then the outliers out, then a least-squares polish on the camera's own model.
The noise is estimated from the residuals, so that the covariances mean what they say.

Gauge: the first pose is held by a tight prior and the distance between the first camera and the one farthest from it
by a range factor; the map is scaled so that the median depth of the landmarks in the first view is 1.

gtsam's Levenberg-Marquardt does not complain about a point with one view, a NaN, or a point behind a camera: these
are checked here, and a failure is a value with its cause.

Focal length: held as stated, or with ``refine_focal`` an unknown that all views share, with a prior; fx and fy keep
their ratio, and all else of the camera is held. A camera that does not turn cannot tell it (stretch the scene along the
optical axis, and a longer lens shows the same), so that the prior decides there, and the standard deviation says so.
It is adjusted in rounds: everything else first, the camera held, with the robust kernel and without outliers; from
there by Newton's method in the focal length; then anew with the new camera, under which other observations may be
outliers. The two-view stage goes before: its bearings are those of the stated camera, whatever is found here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from slam_init.camera import Camera
from slam_init.config import MapConfig
from slam_init.types import Bools, Floats, Ints, Pose

__all__ = [
    "BundleFailure",
    "BundleProblem",
    "BundleSolution",
    "FocalPrior",
    "adjust",
    "calibration_key",
    "camera_with_focal_factor",
    "gtsam_calibration",
    "landmark_key",
    "measured_pixels",
    "pose_key",
    "projection",
]

#: Tracks whose residuals are this many times the expected noise are no tracks of one rigid scene.
_WORST_NOISE = 10.0
#: Tuning constant with 95 % efficiency on Gaussian residuals (Holland and Welsch 1977).
_CAUCHY = 2.3849
#: As good as fixed, and much faster than constrained noise in gtsam.
_GAUGE_SIGMA = 1e-6
#: The scale, relative. It is free otherwise, so the optimum does not depend on this; but a stiff range is a curved
#: constraint along which the optimizer can only creep: with 1e-6 it stopped at 2 to 4 px from starts 3 px off.
_SCALE_SIGMA = 1e-3
#: How well fy / fx is held where the focal length is adjusted: data tell it to a thousandth at best. Stiffer, and the
#: difference of two large numbers in the elimination leaves nothing of what the data say of their sum.
_ASPECT_SIGMA = 1e-5
#: Rounds end where the focal length moves by less: 0.3 px at the border of the image, no other outliers.
_FOCAL_TOLERANCE, _FOCAL_ROUNDS = 1e-3, 5
#: Newton's steps in the focal length end after one that lowers the error by less than this share: of a thousand
#: observations by 0.01, a seventh of a standard deviation, and the next one would be smaller by far.
_NEWTON_TOLERANCE, _NEWTON_STEPS = 1e-5, 10
#: Tried shares of a step. A full one is mostly right; shorter ones are for maps that are wrong.
_STEP_SHARES = (1.0, 0.5, 0.25, 0.1)
#: A focal length that is wrong by more is no matter of adjustment.
_FACTORS = (0.1, 10.0)
_GAUGE = "first pose fixed (prior, 1e-6); distance from the first camera to the farthest one held (prior, 1e-3 of it)"


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Views, landmarks and the observations that join them.

    Attributes
    ----------
    frames : tuple of int
        Absolute frame indices of the views, the first being the reference.
    world_from_cam : tuple of K Pose
    points : (L, 3) float
    track_ids : (L,) int
    views, landmarks : (M,) int
        For each observation its position in ``frames`` and in ``points``.
    pixels : (M, 2) float
        Raw pixels.
    """

    frames: tuple[int, ...]
    world_from_cam: tuple[Pose, ...]
    points: Floats
    track_ids: Ints
    views: Ints
    landmarks: Ints
    pixels: Floats

    def residuals(self, camera: Camera) -> Floats:
        """(M, 2) projected minus observed in raw pixels; NaN where a landmark is behind the camera."""
        predicted = np.full((len(self.views), 2), np.nan)
        for k, pose in enumerate(self.world_from_cam):
            seen = self.views == k
            predicted[seen] = camera.project(pose.inverse().apply(self.points[self.landmarks[seen]]))
        return predicted - self.pixels

    def parallax_rad(self) -> Floats:
        """(L,) largest angle between two rays of a landmark."""
        rays = np.full((len(self.points), len(self.frames), 3), np.nan)
        centres = np.array([pose.t for pose in self.world_from_cam])
        d = self.points[self.landmarks] - centres[self.views]
        rays[self.landmarks, self.views] = d / np.linalg.norm(d, axis=1, keepdims=True)
        cosine = np.einsum("lik,ljk->lij", rays, rays)
        return np.asarray(np.arccos(np.clip(np.nanmin(cosine.reshape(len(rays), -1), axis=1), -1, 1)))

    def keep(self, observations: Bools) -> BundleProblem:
        """Only these observations, and only landmarks that two views still see."""
        counts = np.bincount(self.landmarks[observations], minlength=len(self.points))
        kept = counts >= 2
        chosen = observations & kept[self.landmarks]
        renumbered = np.cumsum(kept) - 1
        return replace(
            self,
            points=self.points[kept],
            track_ids=self.track_ids[kept],
            views=self.views[chosen],
            landmarks=renumbered[self.landmarks[chosen]],
            pixels=self.pixels[chosen],
        )

    def scaled(self, factor: float) -> BundleProblem:
        """The same map in another unit of length."""
        poses = tuple(Pose(pose.R, factor * pose.t) for pose in self.world_from_cam)
        return replace(self, world_from_cam=poses, points=factor * self.points)


@dataclass(frozen=True, eq=False)
class BundleSolution:
    """An adjusted map. Truthy.

    Attributes
    ----------
    problem : BundleProblem
        With adjusted poses and points and without the outliers.
    before : BundleProblem
        The same views, landmarks and scale before adjustment.
    noise_px : float
        Standard deviation of one coordinate, estimated from the residuals and their degrees of freedom.
    rmse_px : float
        Root mean square of the 2-D residuals.
    errors : tuple of float
        Root mean square residual in pixels at the start and after each iteration; while the kernel is robust, of what
        the kernel leaves of the residuals.
    graph, values
        gtsam objects: the final factor graph and its optimum.
    pose_covariances : (K, 6, 6) float
        gtsam's tangent order (rotation, translation) in the camera frame.
    camera : Camera
        With which all this holds: the stated one, or with the adjusted focal length.
    focal_factor : float
        The adjusted focal length over the stated one; 1 where it was held.
    focal_factor_sigma : float or None
        Its standard deviation, by the noise of the tracks and the prior; None where it was held.
    gauge : str
    """

    problem: BundleProblem
    before: BundleProblem
    noise_px: float
    rmse_px: float
    errors: tuple[float, ...]
    graph: Any
    values: Any
    pose_covariances: Floats
    camera: Camera
    focal_factor: float = 1.0
    focal_factor_sigma: float | None = None
    gauge: str = _GAUGE

    def __bool__(self) -> bool:
        return True


@dataclass(frozen=True)
class BundleFailure:
    """Why there is no adjusted map. Falsy."""

    cause: str

    def __bool__(self) -> bool:
        return False


class FocalPrior(NamedTuple):
    """What is known of the focal length beforehand: the stated camera, and a relative standard deviation."""

    camera: Camera
    sigma: float


class _Fit(NamedTuple):
    """A problem at an optimum, the camera it holds for, and the errors on the way."""

    camera: Camera
    problem: BundleProblem
    errors: tuple[float, ...]


def pose_key(frame: int) -> int:
    """The gtsam key ``X(frame)`` of a keyframe's pose, world_from_cam."""
    import gtsam

    return int(gtsam.symbol("x", frame))


def landmark_key(track_id: int) -> int:
    """The gtsam key ``L(track_id)`` of a landmark."""
    import gtsam

    return int(gtsam.symbol("l", track_id))


def calibration_key() -> int:
    """The gtsam key ``K(0)`` of the calibration, where the focal length is adjusted."""
    import gtsam

    return int(gtsam.symbol("k", 0))


def camera_with_focal_factor(camera: Camera, factor: float) -> Camera:
    """The camera with its focal lengths times a factor, as the adjustment changes them.

    Principal point and distortion coefficients are held. A camera with k3 is adjusted on undistorted pixels, which the
    factor must not change: there the coefficients belong to the image, and in units of the new focal length they are
    others.
    """
    fx, fy = factor * camera.fx, factor * camera.fy
    if not _is_undistorted_first(camera):
        return replace(camera, fx=fx, fy=fy)
    powers = (2, 4, 1, 1, 6)  # of k1, k2, p1, p2, k3: each with the degree of its term, less one
    distortion = tuple(k * factor**power for k, power in zip(camera.distortion, powers, strict=True))
    return replace(camera, fx=fx, fy=fy, distortion=distortion)


def gtsam_calibration(camera: Camera) -> Any:
    """The camera as gtsam knows it: Cal3_S2, Cal3DS2 or Cal3Fisheye.

    gtsam's Cal3DS2 has no k3. A camera with k3 is adjusted on undistorted pixels, as a Cal3_S2.
    """
    import gtsam

    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    if camera.model == "fisheye":
        return gtsam.Cal3Fisheye(fx, fy, 0.0, cx, cy, *camera.distortion)
    if camera.is_distorted and not _is_undistorted_first(camera):
        return gtsam.Cal3DS2(fx, fy, 0.0, cx, cy, *camera.distortion[:4])
    return gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)


def _is_undistorted_first(camera: Camera) -> bool:
    return camera.model == "radtan" and len(camera.distortion) == 5 and camera.distortion[4] != 0


def measured_pixels(camera: Camera, pixels: Floats) -> Floats:
    """The pixels that factors on :func:`gtsam_calibration` measure: raw ones, undistorted for a camera with k3."""
    if not _is_undistorted_first(camera):
        return pixels
    return camera.normalize(pixels) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


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
        if prior is not None and isinstance(fit, _Fit):
            fit = _fit_focal(prior, start, fit, config)
        if isinstance(fit, BundleFailure):
            return fit
        final, camera = fit.problem, fit.camera
        residuals = final.residuals(camera)
        noise_px = _least_squares_noise(final, residuals, config)
        graph, values = build_graph(camera, final, noise_px, robust=False, prior=prior)
        covariances, focal_variance = _covariances(graph, values, final.frames, prior)
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
        focal_factor=1.0 if prior is None else camera.fx / prior.camera.fx,
        focal_factor_sigma=None if prior is None else float(np.sqrt(focal_variance)) / prior.camera.fx,
    )


def _fit(camera: Camera, start: BundleProblem, config: MapConfig) -> _Fit | BundleFailure:
    """Robust, then without outliers in least squares, the camera held."""
    # The robust stage only has to tell the outliers: the last digits are left to the polish.
    robust, errors = _optimize(camera, start, config.noise_px, robust=True, iterations=8, tolerance=1e-3)
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
    polished, more = _optimize(camera, cleaned, noise_px, robust=False, iterations=15, tolerance=1e-5)
    final = _scale_to_median_depth(polished)
    if final is None:
        return BundleFailure("no landmark lies in front of the first camera")
    before: Bools = np.asarray(np.isfinite(final.residuals(camera)).all(axis=1))
    if not before.all():
        final = final.keep(before)
        if (failure := _cannot_be_solved(final)) is not None:
            return failure
    return _Fit(camera, final, (*errors, *more))


def _fit_focal(prior: FocalPrior, start: BundleProblem, fit: _Fit, config: MapConfig) -> _Fit | BundleFailure:
    """The focal length as well, from a fit with the stated one: see the module docstring."""
    joint = _adjust_focal(prior, fit, config)
    for _ in range(_FOCAL_ROUNDS):
        if abs(joint.camera.fx / fit.camera.fx - 1) < _FOCAL_TOLERANCE:
            break
        again = _fit(joint.camera, start, config)
        if isinstance(again, BundleFailure):
            break  # the last one stands
        fit = again._replace(errors=(*joint.errors, *again.errors))
        joint = _adjust_focal(prior, fit, config)
    final = _scale_to_median_depth(joint.problem)
    if final is None:
        return BundleFailure("no landmark lies in front of the first camera")
    return joint._replace(problem=final)


def _adjust_focal(prior: FocalPrior, fit: _Fit, config: MapConfig) -> _Fit:
    """Newton's method in the focal length, all else at its optimum for it: before, and again after each step.

    Everything at once would creep: a twentieth more of focal length is a twentieth less of rotation and of the points'
    width, and the square of a twentieth is a pixel. Nor is it left to gtsam's Levenberg-Marquardt: to a factor with a
    variable calibration a landmark behind the camera costs nothing, so that it would be pushed there.
    """
    camera, problem, errors = fit
    noise_px = _least_squares_noise(problem, problem.residuals(camera), config)
    graph, values = build_graph(camera, problem, noise_px, robust=False, prior=prior)
    error = float(graph.error(values))
    for _ in range(_NEWTON_STEPS):
        # The step of all unknowns: its part in the focal length is Newton's.
        step = graph.linearize(values).optimize()
        for share in _STEP_SHARES:
            moved = values.retract(step.scale(share))
            factor = _focal_factor(prior.camera, moved)
            if not _FACTORS[0] < factor < _FACTORS[1]:
                continue
            tried = camera_with_focal_factor(prior.camera, factor)
            polished, more = _optimize(
                tried, _read(moved, problem), noise_px, robust=False, iterations=15, tolerance=1e-6
            )
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
    return _Fit(camera, problem, errors)


def _focal_factor(camera: Camera, values: Any) -> float:
    """The focal length of some values over that of the stated camera."""
    at = getattr(values, f"at{type(gtsam_calibration(camera)).__name__}")
    calibration = at(calibration_key())
    return float(np.sqrt(calibration.fx() * calibration.fy()) / camera.focal_px)


def min_parallax_rad(camera: Camera, noise_px: float, config: MapConfig) -> float:
    """Parallax below which the relative depth of a landmark is less certain than the configuration allows.

    Two rays with noise s each meet under the angle a at a depth with relative standard deviation sqrt(2) s / a.
    """
    return float(np.sqrt(2) * noise_px / camera.focal_px / config.max_depth_sigma)


def estimate_noise(problem: BundleProblem, residuals: Floats, config: MapConfig) -> float:
    """Standard deviation of one coordinate of one observation, robust, corrected for the fitted unknowns."""
    norms = np.linalg.norm(residuals, axis=1)
    norms = norms[np.isfinite(norms)]
    if len(norms) == 0:
        return config.noise_px
    # The median of the norm of a 2-D Gaussian is sqrt(2 ln 2) standard deviations.
    raw = float(np.median(norms) / np.sqrt(2 * np.log(2)))
    return max(raw * float(np.sqrt(2 * len(norms) / _freedom(problem, len(norms)))), config.min_noise_px)


def _least_squares_noise(problem: BundleProblem, residuals: Floats, config: MapConfig) -> float:
    """The same without outliers, where the mean square is better: of few degrees of freedom the median is too low."""
    squares = float(np.sum(residuals**2))
    return max(float(np.sqrt(squares / _freedom(problem, len(residuals)))), config.min_noise_px)


def _freedom(problem: BundleProblem, observations: int) -> float:
    """Coordinates observed less unknowns fitted; a twentieth of the observations at the least.

    An adjusted focal length is one unknown more, and its prior one datum more.
    """
    unknowns = 3 * len(problem.points) + 6 * (len(problem.frames) - 1) - 1
    return max(2.0 * observations - unknowns, 0.05 * observations)


def projection(camera: Camera, noise: Any, *, adjusted: bool) -> Callable[[Floats, int, int], Any]:
    """What makes a reprojection factor of a measured pixel, the key of a pose and the key of a landmark.

    Parameters
    ----------
    camera : Camera
    noise
        gtsam noise model of a pixel.
    adjusted : bool
        Whether the calibration is the variable ``K(0)``; else it is held.
    """
    import gtsam

    calibration = gtsam_calibration(camera)
    name = type(calibration).__name__
    if adjusted:
        shared, key = getattr(gtsam, f"GeneralSFMFactor2{name}"), calibration_key()
        return lambda pixel, pose, landmark: shared(pixel, noise, pose, landmark, key)
    held = getattr(gtsam, f"GenericProjectionFactor{name}")
    return lambda pixel, pose, landmark: held(pixel, noise, pose, landmark, calibration, False, False)


def build_graph(
    camera: Camera, problem: BundleProblem, noise_px: float, *, robust: bool, prior: FocalPrior | None = None
) -> tuple[Any, Any]:
    """The factor graph and values of a problem: reprojection factors, pose prior, baseline range.

    With a prior of the focal length the calibration is a variable; its value is that of ``camera``.
    """
    import gtsam

    noise: Any = gtsam.noiseModel.Isotropic.Sigma(2, noise_px)
    if robust:
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(_CAUCHY), noise)
    factor = projection(camera, noise, adjusted=prior is not None)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    pose_keys = [pose_key(frame) for frame in problem.frames]
    point_keys = [landmark_key(track) for track in problem.track_ids.tolist()]
    for key, pose in zip(pose_keys, problem.world_from_cam, strict=True):
        values.insert(key, gtsam.Pose3(gtsam.Rot3(pose.R), pose.t))
    for key, point in zip(point_keys, problem.points, strict=True):
        values.insert(key, point)
    pixels = measured_pixels(camera, problem.pixels)
    for k, landmark, pixel in zip(problem.views.tolist(), problem.landmarks.tolist(), pixels, strict=True):
        graph.add(factor(pixel, pose_keys[k], point_keys[landmark]))
    first = problem.world_from_cam[0]
    fixed = gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)
    graph.add(gtsam.PriorFactorPose3(pose_keys[0], gtsam.Pose3(gtsam.Rot3(first.R), first.t), fixed))
    baselines = [float(np.linalg.norm(pose.t - first.t)) for pose in problem.world_from_cam]
    far = int(np.argmax(baselines))
    range_noise = gtsam.noiseModel.Isotropic.Sigma(1, _SCALE_SIGMA * baselines[far])
    graph.add(gtsam.RangeFactorPose3(pose_keys[0], pose_keys[far], baselines[far], range_noise))
    if prior is not None:
        values.insert(calibration_key(), gtsam_calibration(camera))
        graph.add(_calibration_prior(prior))
    return graph, values


def _calibration_prior(prior: FocalPrior) -> Any:
    """A factor on ``K(0)``: its prior sigma along (fx, fy); their ratio and all other parameters held."""
    import gtsam

    mean = gtsam_calibration(prior.camera)
    focal = np.array([prior.camera.fx, prior.camera.fy])
    length = float(np.linalg.norm(focal))
    along = focal / length
    whiten = np.eye(mean.dim()) / _GAUGE_SIGMA
    whiten[0, :2] = along / (prior.sigma * length)
    whiten[1, :2] = np.array([-along[1], along[0]]) / (_ASPECT_SIGMA * length)
    # gtsam wants the square root of the information as an upper triangle.
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(np.linalg.qr(whiten)[1])
    return getattr(gtsam, f"PriorFactor{type(mean).__name__}")(calibration_key(), mean, noise)


def _optimize(
    camera: Camera, problem: BundleProblem, noise_px: float, *, robust: bool, iterations: int, tolerance: float
) -> tuple[BundleProblem, list[float]]:
    import gtsam

    graph, values = build_graph(camera, problem, noise_px, robust=robust)
    errors = [_rms_px(float(graph.error(values)), noise_px, problem)]
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(iterations)
    params.setRelativeErrorTol(tolerance)
    params.iterationHook = lambda _iteration, _old, new: errors.append(_rms_px(float(new), noise_px, problem))
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
    if not np.isfinite(graph.error(optimum)):
        raise RuntimeError("bundle adjustment diverged: the error is not finite")
    return _read(optimum, problem), errors


def _rms_px(error: float, noise_px: float, problem: BundleProblem) -> float:
    """Root mean square of the 2-D residuals, of gtsam's error."""
    return float(noise_px * np.sqrt(2 * error / len(problem.views)))


def _read(values: Any, problem: BundleProblem) -> BundleProblem:
    """The problem with the poses and points of some values."""
    poses = tuple(_pose(values.atPose3(pose_key(frame))) for frame in problem.frames)
    points = np.array([values.atPoint3(landmark_key(track)) for track in problem.track_ids.tolist()])
    return replace(problem, world_from_cam=poses, points=points.reshape(-1, 3))


def _pose(pose3: Any) -> Pose:
    return Pose(np.asarray(pose3.rotation().matrix(), float), np.asarray(pose3.translation(), float))


def _covariances(graph: Any, values: Any, frames: tuple[int, ...], prior: FocalPrior | None) -> tuple[Floats, float]:
    """Marginal covariances (K, 6, 6) of the poses, and the variance of fx in square pixels; 0 where it is held."""
    import gtsam

    marginals = gtsam.Marginals(graph, values)
    poses = np.array([marginals.marginalCovariance(pose_key(frame)) for frame in frames])
    return poses, 0.0 if prior is None else float(marginals.marginalCovariance(calibration_key())[0, 0])


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
