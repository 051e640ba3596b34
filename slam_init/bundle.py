"""Bundle adjustment of the initial map: the only module of the pipeline that imports gtsam.

Recipe: a robust kernel first (Cauchy), then the outliers out, then a least-squares polish on the camera's own model.
The noise is estimated from the residuals, so that the covariances mean what they say.

Gauge: the first pose is held by a tight prior and the distance between the first camera and the one farthest from it
by a range factor; the map is scaled so that the median depth of the landmarks in the first view is 1.

gtsam's Levenberg-Marquardt does not complain about a point with one view, a NaN, or a point behind a camera: these
are checked here, and a failure is a value with its cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slam_init.camera import Camera
from slam_init.config import MapConfig
from slam_init.types import Bools, Floats, Ints, Pose

__all__ = [
    "BundleFailure",
    "BundleProblem",
    "BundleSolution",
    "adjust",
    "gtsam_calibration",
    "landmark_key",
    "pose_key",
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
    gauge: str = _GAUGE

    def __bool__(self) -> bool:
        return True


@dataclass(frozen=True)
class BundleFailure:
    """Why there is no adjusted map. Falsy."""

    cause: str

    def __bool__(self) -> bool:
        return False


def pose_key(frame: int) -> int:
    """The gtsam key ``X(frame)`` of a keyframe's pose, world_from_cam."""
    import gtsam

    return int(gtsam.symbol("x", frame))


def landmark_key(track_id: int) -> int:
    """The gtsam key ``L(track_id)`` of a landmark."""
    import gtsam

    return int(gtsam.symbol("l", track_id))


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
    """Adjust poses and landmarks; see the module docstring.

    Parameters
    ----------
    camera : Camera
    problem : BundleProblem
        World frame = camera frame of the first view.
    config : MapConfig
    """
    start = _scale_to_median_depth(problem)
    if start is None:
        return BundleFailure("no landmark lies in front of the first camera")
    try:
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
        residuals = final.residuals(camera)
        before: Bools = np.asarray(np.isfinite(residuals).all(axis=1))
        if not before.all():
            final = final.keep(before)
            if (failure := _cannot_be_solved(final)) is not None:
                return failure
            residuals = final.residuals(camera)
        # Without outliers the mean square is the better estimate: of few degrees of freedom the median is too low.
        squares = float(np.sum(residuals**2))
        noise_px = max(float(np.sqrt(squares / _freedom(final, len(residuals)))), config.min_noise_px)
        graph, values = build_graph(camera, final, noise_px, robust=False)
        covariances = _pose_covariances(graph, values, final.frames)
    except RuntimeError as error:  # how gtsam reports singular systems and cheirality
        return BundleFailure(" ".join(str(error).split())[:160])
    return BundleSolution(
        problem=final,
        before=_same_landmarks(start, final),
        noise_px=noise_px,
        rmse_px=float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))),
        errors=(*errors, *more),
        graph=graph,
        values=values,
        pose_covariances=covariances,
    )


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


def _freedom(problem: BundleProblem, observations: int) -> float:
    """Coordinates observed less unknowns fitted; a twentieth of the observations at the least."""
    unknowns = 3 * len(problem.points) + 6 * (len(problem.frames) - 1) - 1
    return max(2.0 * observations - unknowns, 0.05 * observations)


def build_graph(camera: Camera, problem: BundleProblem, noise_px: float, *, robust: bool) -> tuple[Any, Any]:
    """The factor graph and values of a problem: reprojection factors, pose prior, baseline range."""
    import gtsam

    calibration = gtsam_calibration(camera)
    factor = {
        "Cal3_S2": gtsam.GenericProjectionFactorCal3_S2,
        "Cal3DS2": gtsam.GenericProjectionFactorCal3DS2,
        "Cal3Fisheye": gtsam.GenericProjectionFactorCal3Fisheye,
    }[type(calibration).__name__]
    noise: Any = gtsam.noiseModel.Isotropic.Sigma(2, noise_px)
    if robust:
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(_CAUCHY), noise)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    pose_keys = [pose_key(frame) for frame in problem.frames]
    point_keys = [landmark_key(track) for track in problem.track_ids.tolist()]
    for key, pose in zip(pose_keys, problem.world_from_cam, strict=True):
        values.insert(key, gtsam.Pose3(gtsam.Rot3(pose.R), pose.t))
    for key, point in zip(point_keys, problem.points, strict=True):
        values.insert(key, point)
    pixels = measured_pixels(camera, problem.pixels)
    for k, landmark, pixel in zip(problem.views.tolist(), problem.landmarks.tolist(), pixels, strict=True):
        graph.add(factor(pixel, noise, pose_keys[k], point_keys[landmark], calibration, False, False))
    first = problem.world_from_cam[0]
    fixed = gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)
    graph.add(gtsam.PriorFactorPose3(pose_keys[0], gtsam.Pose3(gtsam.Rot3(first.R), first.t), fixed))
    baselines = [float(np.linalg.norm(pose.t - first.t)) for pose in problem.world_from_cam]
    far = int(np.argmax(baselines))
    range_noise = gtsam.noiseModel.Isotropic.Sigma(1, _SCALE_SIGMA * baselines[far])
    graph.add(gtsam.RangeFactorPose3(pose_keys[0], pose_keys[far], baselines[far], range_noise))
    return graph, values


def _optimize(
    camera: Camera, problem: BundleProblem, noise_px: float, *, robust: bool, iterations: int, tolerance: float
) -> tuple[BundleProblem, list[float]]:
    import gtsam

    graph, values = build_graph(camera, problem, noise_px, robust=robust)

    def rms_px(error: float) -> float:
        return float(noise_px * np.sqrt(2 * error / len(problem.views)))

    errors = [rms_px(float(graph.error(values)))]
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(iterations)
    params.setRelativeErrorTol(tolerance)
    params.iterationHook = lambda _iteration, _old, new: errors.append(rms_px(float(new)))
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
    if not np.isfinite(graph.error(optimum)):
        raise RuntimeError("bundle adjustment diverged: the error is not finite")
    poses = tuple(_pose(optimum.atPose3(pose_key(frame))) for frame in problem.frames)
    points = np.array([optimum.atPoint3(landmark_key(track)) for track in problem.track_ids.tolist()])
    return replace(problem, world_from_cam=poses, points=points.reshape(-1, 3)), errors


def _pose(pose3: Any) -> Pose:
    return Pose(np.asarray(pose3.rotation().matrix(), float), np.asarray(pose3.translation(), float))


def _pose_covariances(graph: Any, values: Any, frames: tuple[int, ...]) -> Floats:
    import gtsam

    marginals = gtsam.Marginals(graph, values)
    return np.array([marginals.marginalCovariance(pose_key(frame)) for frame in frames])


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
