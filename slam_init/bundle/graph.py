"""The factor graph of bundle adjustment and its optimum: the only module of the pipeline that imports gtsam.

Variables: ``X(frame)`` are poses, ``L(track)`` landmarks, and ``K(0)`` is the calibration where it is adjusted; else it
is held.

Gauge: the first pose is held by a tight prior and the distance between the first camera and the one farthest from it
by a range factor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from slam_init.bundle.problem import BundleProblem, FocalPrior
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

__all__ = [
    "GAUGE",
    "build_graph",
    "calibration_key",
    "gtsam_calibration",
    "is_undistorted_first",
    "landmark_key",
    "marginal_covariances",
    "measured_pixels",
    "optimize",
    "pose_key",
    "projection",
    "read_focal_factor",
    "read_problem",
]

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
#: The gauge in words.
GAUGE = "first pose fixed (prior, 1e-6); distance from the first camera to the farthest one held (prior, 1e-3 of it)"


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


def gtsam_calibration(camera: Camera) -> Any:
    """The camera as gtsam knows it: Cal3_S2, Cal3DS2 or Cal3Fisheye.

    gtsam's Cal3DS2 has no k3. A camera with k3 is adjusted on undistorted pixels, as a Cal3_S2.
    """
    import gtsam

    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    if camera.model == "fisheye":
        return gtsam.Cal3Fisheye(fx, fy, 0.0, cx, cy, *camera.distortion)
    if camera.is_distorted and not is_undistorted_first(camera):
        return gtsam.Cal3DS2(fx, fy, 0.0, cx, cy, *camera.distortion[:4])
    return gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)


def is_undistorted_first(camera: Camera) -> bool:
    """Whether the camera has k3, so that factors measure undistorted pixels."""
    return camera.model == "radtan" and len(camera.distortion) == 5 and camera.distortion[4] != 0


def measured_pixels(camera: Camera, pixels: Floats) -> Floats:
    """The pixels that factors on :func:`gtsam_calibration` measure: raw ones, undistorted for a camera with k3."""
    if not is_undistorted_first(camera):
        return pixels
    return camera.normalize(pixels) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


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


def optimize(
    camera: Camera, problem: BundleProblem, noise_px: float, *, robust: bool, iterations: int, tolerance: float
) -> tuple[BundleProblem, list[float]]:
    """The optimum for a held camera, and the root mean square residual at the start and after each iteration."""
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
    return read_problem(optimum, problem), errors


def _rms_px(error: float, noise_px: float, problem: BundleProblem) -> float:
    """Root mean square of the 2-D residuals, of gtsam's error."""
    return float(noise_px * np.sqrt(2 * error / len(problem.views)))


def read_problem(values: Any, problem: BundleProblem) -> BundleProblem:
    """The problem with the poses and points of some values."""
    poses = tuple(_pose(values.atPose3(pose_key(frame))) for frame in problem.frames)
    points = np.array([values.atPoint3(landmark_key(track)) for track in problem.track_ids.tolist()])
    return replace(problem, world_from_cam=poses, points=points.reshape(-1, 3))


def _pose(pose3: Any) -> Pose:
    return Pose(np.asarray(pose3.rotation().matrix(), float), np.asarray(pose3.translation(), float))


def read_focal_factor(camera: Camera, values: Any) -> float:
    """The focal length of some values over that of the stated camera."""
    at = getattr(values, f"at{type(gtsam_calibration(camera)).__name__}")
    calibration = at(calibration_key())
    return float(np.sqrt(calibration.fx() * calibration.fy()) / camera.focal_px)


def marginal_covariances(
    graph: Any, values: Any, frames: tuple[int, ...], prior: FocalPrior | None
) -> tuple[Floats, float]:
    """Marginal covariances (K, 6, 6) of the poses, and the variance of fx in square pixels; 0 where it is held."""
    import gtsam

    marginals = gtsam.Marginals(graph, values)
    poses = np.array([marginals.marginalCovariance(pose_key(frame)) for frame in frames])
    return poses, 0.0 if prior is None else float(marginals.marginalCovariance(calibration_key())[0, 0])
