"""Scale, gravity and biases from the poses of a map and a record of an inertial sensor between them.

The poses of a map have no scale. Its joint covariance says how well they are known to each other. Unknown are the poses
and velocities of the sensor in metres, in a world whose z axis points up, one bias of the gyroscope and of the
accelerometer for all of the time, the scale, and the delay of the clocks. A factor of gtsam states the measurements
between two poses, preintegrated [F17]_; one factor states the map. The bias of a second or two is constant: it walks by
less than a hundredth of what is not known of it.

The start is linear in scale, gravity and velocities, with the rotations of the map [M14]_. The direction of gravity and
the bias of the accelerometer can hardly be distinguished while the camera turns little, and need not be: the scale
comes from accelerations that change.

References
----------
.. [F17] C. Forster, L. Carlone, F. Dellaert, D. Scaramuzza, "On-manifold preintegration for real-time visual-inertial
   odometry", IEEE Transactions on Robotics 33, 2017.
.. [M14] A. Martinelli, "Closed-form solution of visual-inertial structure from motion", IJCV 106, 2014.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import gtsam
import numpy as np

from quest.geometry.quaternion import vector_from_rotation
from slam_init.types.arrays import Floats
from slam_init.types.inertial import ACCELEROMETER_BIAS_M_S2, STANDARD_GRAVITY, Gravity, InertialRecord
from slam_init.types.pose import Pose

#: Offset of a gyroscope before it is calibrated. Data sheets state 0.01 to 0.35 rad/s; the one of EuRoC has 0.08 rad/s.
#: Class: assumption.
_GYROSCOPE_BIAS_RAD_S = 0.1
#: Relative error of the rates: data sheets state 0.5 to 3 % of scale and cross-axis sensitivity.
#: Class: assumption.
_GYROSCOPE_SCALE = 0.01
#: Relative error of the scale of each axis of a calibrated accelerometer.
#: Class: assumption.
_ACCELEROMETER_SCALE = 0.005
#: The prior of the first pose makes its heading and its place definite, which nothing measures. Its tilt is free.
_FREE_RAD, _HELD_RAD, _HELD_M = 10.0, 1e-3, 1e-3
_ITERATIONS, _STARTS = 60, 5
#: Of a numerical derivative by a scale, in which preintegration is linear.
_SCALE_STEP = 1e-3


class Alignment(NamedTuple):
    """How the map and the record fit together."""

    #: Distance between two cameras in metres, and its relative standard deviation.
    distance_m: float
    sigma: float
    #: In the first camera.
    gravity: Gravity
    #: Of the normalized residuals: sum of squares, and their number minus that of the unknowns.
    chi_square: float
    freedom: int


@dataclass(frozen=True, eq=False)
class VisualMotion:
    """The motion of a camera by a map, in its own unit."""

    #: (K,) Strictly increasing.
    times_s: Floats
    #: The poses in the first camera; the first one is the identity.
    first_from_cam: tuple[Pose, ...]
    #: (6 K - 6, 6 K - 6) Joint covariance of the other poses in gtsam's tangent order, for a held first pose.
    covariance: Floats

    @staticmethod
    def of_poses(times_s: Floats, world_from_cam: Sequence[Pose], covariance: Floats) -> VisualMotion:
        """Express poses and their joint covariance in the first camera.

        Shapes: ``times_s`` (K,), ``covariance`` (6 K, 6 K).
        """
        poses = tuple(world_from_cam[0].inverse() @ pose for pose in world_from_cam)
        by_first = np.concatenate([_adjoint(pose.inverse()) for pose in poses[1:]])
        by_all = np.concatenate([-by_first, np.eye(len(by_first))], axis=1)
        return VisualMotion(times_s, poses, by_all @ covariance @ by_all.T)


class _Interval(NamedTuple):
    """The measurements between two poses, preintegrated."""

    measured: gtsam.PreintegratedImuMeasurements
    duration_s: float


def turning_misfit(motion: VisualMotion, record: InertialRecord) -> tuple[float, int] | None:
    """Compare the rotations of a map with those of the gyroscope.

    * Returns: Sum of squares of the normalized differences for the best bias, and their number; None where the record
      does not cover the poses.
    """
    intervals = _preintegrated(motion, record, np.zeros(6))
    return None if intervals is None else _gyroscope_bias(motion, record, intervals)[1:]


def align(motion: VisualMotion, record: InertialRecord, far: int) -> Alignment | None:
    """Find scale and gravity.

    * ``far``: Position of the camera whose distance from the first one is asked for.
    * Returns: None where the record does not cover the poses, or where no scale is positive.
    """
    rough = _preintegrated(motion, record, np.zeros(6))
    if rough is None:
        return None
    bias = np.zeros(6)
    bias[3:] = _gyroscope_bias(motion, record, rough)[0]
    intervals = _preintegrated(motion, record, bias)
    assert intervals is not None
    start = _linear_start(motion, record, intervals)
    return None if start is None else _refined(motion, record, intervals, bias, far, *start)


# -- measurements ----------------------------------------------------------------------------------


def _preintegrated(
    motion: VisualMotion, record: InertialRecord, bias: Floats, scaled: Floats | tuple[float, ...] = (1.0, 1.0, 1.0)
) -> list[_Interval] | None:
    """Preintegrate the record between the poses, with a bias (6,): accelerometer, gyroscope.

    Shapes: ``scaled`` (3,).

    * ``scaled``: Factors on the accelerations along the axes of the sensor.
    """
    intervals = []
    for t0_s, t1_s in pairwise(motion.times_s.tolist()):
        steps = record.steps(t0_s, t1_s)
        if steps is None:
            return None
        durations_s, rates, accelerations = steps
        # An error of the scale of the rates grows with the angle, and noise with the root of the time.
        angle_rad = float(np.linalg.norm(durations_s @ rates))
        rate_variance = record.gyroscope_density**2 + (_GYROSCOPE_SCALE * angle_rad) ** 2 / (t1_s - t0_s)
        params = gtsam.PreintegrationParams.MakeSharedU(STANDARD_GRAVITY)
        params.setGyroscopeCovariance(rate_variance * np.eye(3))
        params.setAccelerometerCovariance(record.accelerometer_density**2 * np.eye(3))
        params.setIntegrationCovariance(1e-10 * np.eye(3))
        measured = gtsam.PreintegratedImuMeasurements(params, gtsam.imuBias.ConstantBias(bias[:3], bias[3:]))
        for duration_s, rate, acceleration in zip(durations_s, rates, accelerations * scaled, strict=True):
            measured.integrateMeasurement(acceleration, rate, duration_s)
        intervals.append(_Interval(measured, t1_s - t0_s))
    return intervals


def _gyroscope_bias(
    motion: VisualMotion, record: InertialRecord, intervals: Sequence[_Interval]
) -> tuple[Floats, float, int]:
    """The bias of the gyroscope by the rotations of the map, the misfit that is left, and the number of residuals.

    The bias turns a short interval by itself times the duration; it is small, and so is the error of this.
    """
    R_cam_from_imu = record.cam_from_imu.R
    residuals, by_poses, noise = [], np.zeros((3 * len(intervals), len(motion.covariance) + 6)), []
    for k, (interval, (a, b)) in enumerate(zip(intervals, pairwise(motion.first_from_cam), strict=True)):
        measured = R_cam_from_imu @ interval.measured.deltaRij().matrix() @ R_cam_from_imu.T
        turned = a.R.T @ b.R
        residuals.append(vector_from_rotation(measured.T @ turned))
        by_poses[3 * k : 3 * k + 3, 6 * k : 6 * k + 3] = -turned.T
        by_poses[3 * k : 3 * k + 3, 6 * k + 6 : 6 * k + 9] = np.eye(3)
        noise.append(interval.measured.preintMeasCov()[:3, :3])
    by_poses = by_poses[:, 6:]  # the first pose is held
    covariance = by_poses @ motion.covariance @ by_poses.T
    for k, own in enumerate(noise):
        covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += R_cam_from_imu @ own @ R_cam_from_imu.T
    by_bias = np.concatenate([-interval.duration_s * R_cam_from_imu for interval in intervals])
    stacked = np.concatenate(residuals)
    weighted = np.linalg.solve(covariance, by_bias)
    information = by_bias.T @ weighted + np.eye(3) / _GYROSCOPE_BIAS_RAD_S**2
    bias = np.linalg.solve(information, weighted.T @ stacked)
    left = stacked - by_bias @ bias
    misfit = float(left @ np.linalg.solve(covariance, left)) + float(bias @ bias) / _GYROSCOPE_BIAS_RAD_S**2
    return np.asarray(bias), misfit, len(stacked)


# -- linear start ----------------------------------------------------------------------------------


def _linear_start(
    motion: VisualMotion, record: InertialRecord, intervals: Sequence[_Interval]
) -> tuple[float, Floats, Floats] | None:
    """Scale, gravity (3,) and velocities (K, 3) in the first camera, for given rotations.

    The norm of gravity is known, which is not linear: it is stated along the last estimate of its direction.
    """
    count, arm = len(motion.times_s), record.cam_from_imu
    rotations = [pose.R @ arm.R for pose in motion.first_from_cam]
    variances = motion.covariance.diagonal().reshape(-1, 6)[:, 3:].mean(axis=1)
    scale, gravity = 1.0, np.zeros(3)
    for _ in range(_STARTS):
        rows, right = [], []
        for k, (measured, dt) in enumerate(intervals):
            a, b = motion.first_from_cam[k], motion.first_from_cam[k + 1]
            # Unknowns: scale, gravity, velocities.
            place, speed = np.zeros((3, 4 + 3 * count)), np.zeros((3, 4 + 3 * count))
            place[:, 0], place[:, 1:4] = b.t - a.t, -0.5 * dt**2 * np.eye(3)
            place[:, 4 + 3 * k : 7 + 3 * k] = -dt * np.eye(3)
            speed[:, 1:4] = -dt * np.eye(3)
            speed[:, 4 + 3 * k : 7 + 3 * k], speed[:, 7 + 3 * k : 10 + 3 * k] = -np.eye(3), np.eye(3)
            seen = scale * math.sqrt(variances[k] + variances[max(k - 1, 0)])
            noise = np.sqrt(np.diag(measured.preintMeasCov()))
            known = rotations[k] @ measured.deltaPij() + (a.R - b.R) @ arm.t
            for row, value, sigma in (
                (place, known, math.hypot(seen, noise[3])),
                (speed, rotations[k] @ measured.deltaVij(), noise[6]),
            ):
                rows.append(row / sigma)
                right.append(value / sigma)
        if gravity.any():
            row = np.zeros((1, 4 + 3 * count))
            row[0, 1:4] = gravity / np.linalg.norm(gravity) / ACCELEROMETER_BIAS_M_S2
            rows.append(row)
            right.append(np.array([STANDARD_GRAVITY / ACCELEROMETER_BIAS_M_S2]))
        solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right))[0]
        scale, gravity = abs(float(solution[0])) or 1.0, solution[1:4]
        if not gravity.any():
            return None
    return (scale, gravity, solution[4:].reshape(-1, 3)) if solution[0] > 0 else None


# -- joint estimate --------------------------------------------------------------------------------


def _refined(
    motion: VisualMotion,
    record: InertialRecord,
    intervals: Sequence[_Interval],
    bias: Floats,
    far: int,
    scale: float,
    gravity: Floats,
    velocities: Floats,
) -> Alignment | None:
    """The optimum of all factors, from a start."""
    count, arm = len(motion.times_s), record.cam_from_imu
    upright_from_first = _upright(gravity)
    B, S, D = (gtsam.symbol(name, 0) for name in "bsd")
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, (pose, velocity) in enumerate(zip(motion.first_from_cam, velocities, strict=True)):
        rotation, place = pose.R @ arm.R, scale * pose.t + pose.R @ arm.t
        at = gtsam.Pose3(gtsam.Rot3(upright_from_first @ rotation), upright_from_first @ place)
        values.insert(gtsam.symbol("x", k), at)
        values.insert(gtsam.symbol("v", k), upright_from_first @ velocity)
    values.insert(B, gtsam.imuBias.ConstantBias(bias[:3], bias[3:]))
    values.insert(S, np.array([math.log(scale)]))
    values.insert(D, np.zeros(1))
    for factor in _inertial_factors(intervals, B):
        graph.add(factor)
    diagonal = gtsam.noiseModel.Diagonal.Sigmas
    graph.add(_held(gtsam.symbol("x", 0), values.atPose3(gtsam.symbol("x", 0))))
    offsets = diagonal(np.repeat([ACCELEROMETER_BIAS_M_S2, _GYROSCOPE_BIAS_RAD_S], 3))
    graph.add(gtsam.PriorFactorConstantBias(B, gtsam.imuBias.ConstantBias(), offsets))
    graph.add(gtsam.PriorFactorVector(D, np.zeros(1), diagonal(np.array([max(record.clock_sigma_s, 1e-6)]))))
    graph.add(_map_factor(motion, record, B, S, D))
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(_ITERATIONS)
    # Some intervals are known to micrometres, and the biases hardly: the squares of normal equations lose the digits.
    params.setLinearSolverType("MULTIFRONTAL_QR")
    try:
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
        jacobian = graph.linearize(values).jacobian()[0]
        inverse = np.linalg.inv(np.linalg.qr(jacobian, mode="r"))
    except (RuntimeError, np.linalg.LinAlgError):  # the poses do not determine the unknowns
        return None
    # gtsam sorts the unknowns of a matrix by their keys: biases, delay, scale, velocities, poses.
    first = inverse[8 + 3 * count : 14 + 3 * count]
    tilts = first[:3] @ first[:3].T
    poses = [values.atPose3(gtsam.symbol("x", k)) for k in (0, far)]
    # The camera moves with the sensor, and turns about it.
    by_imu = _adjoint(arm)[3:]
    cameras = [pose.compose(gtsam.Pose3(gtsam.Rot3(arm.R), arm.t).inverse()) for pose in poses]
    apart = cameras[1].translation() - cameras[0].translation()
    distance_m = float(np.linalg.norm(apart))
    last = inverse[8 + 3 * count + 6 * far : 14 + 3 * count + 6 * far]
    moved = [camera.rotation().unrotate(apart) @ by_imu for camera in cameras]
    log_distance = (moved[1] @ last - moved[0] @ first) / distance_m**2
    by_scales = jacobian.T @ _by_scales(motion, record, intervals, bias, values, len(jacobian))
    of_scales = _ACCELEROMETER_SCALE * log_distance @ (inverse.T @ by_scales)
    imu_from_upright = values.atPose3(gtsam.symbol("x", 0)).rotation().matrix().T
    down = -imu_from_upright[:, 2]
    # The heading is free: it turns about gravity, which does not change its direction.
    across = np.eye(3) - np.outer(down, down)
    sigma_deg = math.degrees(math.sqrt(0.5 * float(np.trace(across @ tilts @ across))))
    return Alignment(
        distance_m=distance_m,
        sigma=math.hypot(float(np.linalg.norm(log_distance)), float(np.linalg.norm(of_scales))),
        gravity=Gravity(arm.R @ down, min(max(sigma_deg, 1e-3), 45.0)),
        chi_square=2 * float(graph.error(values)),
        # Residuals: nine of an interval, six of a pose but the first, the biases, the delay. Unknowns: a pose and a
        # velocity each, the biases, the delay, the scale; heading and place are no unknowns.
        freedom=6 * count - 12,
    )


def _inertial_factors(intervals: Sequence[_Interval], B: int) -> list[gtsam.ImuFactor]:
    factors = []
    for k, interval in enumerate(intervals):
        x0, v0, x1, v1 = (gtsam.symbol(name, k + step) for step in (0, 1) for name in "xv")
        factors.append(gtsam.ImuFactor(x0, v0, x1, v1, B, interval.measured))
    return factors


def _by_scales(
    motion: VisualMotion,
    record: InertialRecord,
    intervals: Sequence[_Interval],
    bias: Floats,
    values: gtsam.Values,
    rows: int,
) -> Floats:
    """How the normalized residuals follow the scale of each axis of the accelerometer, which is no unknown.

    Shapes: returns (R, 3).

    * ``rows``: Number of residuals R; those of the intervals are the first ones.
    """
    B, derivatives = gtsam.symbol("b", 0), np.zeros((rows, 3))

    def residuals(ones: Sequence[_Interval]) -> Floats:
        return np.concatenate([factor.whitenedError(values) for factor in _inertial_factors(ones, B)])

    known = residuals(intervals)
    for axis in range(3):
        changed = _preintegrated(motion, record, bias, 1.0 + _SCALE_STEP * np.eye(3)[axis])
        assert changed is not None
        derivatives[: len(known), axis] = (residuals(changed) - known) / _SCALE_STEP
    return derivatives


def _held(key: int, pose: gtsam.Pose3) -> gtsam.NonlinearFactor:
    """A prior of a pose that holds its heading and its place."""
    up = pose.rotation().matrix().T[:, 2]
    covariance = np.diag(np.repeat([_FREE_RAD**2, _HELD_M**2], 3))
    covariance[:3, :3] += (_HELD_RAD**2 - _FREE_RAD**2) * np.outer(up, up)
    factor: gtsam.NonlinearFactor = gtsam.PriorFactorPose3(key, pose, gtsam.noiseModel.Gaussian.Covariance(covariance))
    return factor


def _map_factor(motion: VisualMotion, record: InertialRecord, B: int, S: int, D: int) -> gtsam.CustomFactor:
    """The factor of the map: its poses in the first camera, with their joint covariance.

    A camera whose clock is late shows the pose at which the sensor was before: it moves on by its velocity.
    """
    count, imu_from_cam = len(motion.times_s), record.cam_from_imu.inverse()
    arm = gtsam.Pose3(gtsam.Rot3(imu_from_cam.R), imu_from_cam.t)
    by_imu = _adjoint(imu_from_cam.inverse())
    rates = np.array([record.rates_rad_s[np.argmin(np.abs(record.timestamps_s - t))] for t in motion.times_s])
    x, v = ([gtsam.symbol(name, k) for k in range(count)] for name in "xv")

    def error(_: Any, values: gtsam.Values, jacobians: list[Floats] | None) -> Floats:
        scale, delay_s = math.exp(float(values.atVector(S)[0])), float(values.atVector(D)[0])
        rate_bias = values.atConstantBias(B).gyroscope()
        cameras, twists = [], []
        for k in range(count):
            pose = values.atPose3(x[k])
            velocity = pose.rotation().matrix().T @ values.atVector(v[k])
            twists.append(by_imu @ np.concatenate([rates[k] - rate_bias, velocity]))
            cameras.append(pose.compose(arm).compose(gtsam.Pose3.Expmap(delay_s * twists[k])))
        residuals = np.zeros((count - 1, 6))
        blocks = [np.zeros((6 * count - 6, 6)) for _ in range(count)]
        by_scale, by_delay = np.zeros((6 * count - 6, 1)), np.zeros((6 * count - 6, 1))
        for k in range(1, count):
            seen, between = motion.first_from_cam[k], cameras[0].between(cameras[k])
            off, moved = seen.R.T @ between.rotation().matrix(), seen.R.T @ between.translation() / scale
            residuals[k - 1, :3] = vector_from_rotation(off)
            residuals[k - 1, 3:] = moved - seen.R.T @ seen.t
            # By the motion of the camera in its own axes; the residual of the rotation is small.
            rows, by_camera = slice(6 * k - 6, 6 * k), np.zeros((6, 6))
            by_camera[:3, :3], by_camera[3:, 3:] = np.eye(3), off / scale
            by_first = -by_camera @ between.inverse().AdjointMap()
            blocks[k][rows], blocks[0][rows] = by_camera @ by_imu, by_first @ by_imu
            by_scale[6 * k - 3 : 6 * k, 0] = -moved
            by_delay[rows, 0] = by_camera @ twists[k] + by_first @ twists[0]
        if jacobians is not None:
            for k in range(count):
                jacobians[k] = blocks[k]
                jacobians[count + k] = np.zeros((6 * count - 6, 3))
            jacobians[2 * count], jacobians[2 * count + 1] = np.zeros((6 * count - 6, 6)), by_scale
            jacobians[2 * count + 2] = by_delay
        return residuals.ravel()

    noise = gtsam.noiseModel.Gaussian.Covariance(motion.covariance)
    return gtsam.CustomFactor(noise, [*x, *v, B, S, D], error)


def _adjoint(pose: Pose) -> Floats:
    """How a small motion (rotation, translation) looks from another frame, (6, 6)."""
    x, y, z = pose.t
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[pose.R, np.zeros((3, 3))], [cross @ pose.R, pose.R]])


def _upright(gravity: Floats) -> Floats:
    """A rotation (3, 3) that takes gravity to minus the z axis."""
    up = -gravity / np.linalg.norm(gravity)
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side /= np.linalg.norm(side)
    return np.array([side, np.cross(up, side), up])
