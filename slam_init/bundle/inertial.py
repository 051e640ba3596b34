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
from itertools import pairwise
from typing import Any, NamedTuple

import gtsam
import numpy as np

from quest.geometry.quaternion import vector_from_rotation
from slam_init.bundle.graph import pose_key
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
#: Keys of the biases, of the logarithm of the scale, and of the delay of the clocks.
_BIAS, _SCALE, _DELAY = (gtsam.symbol(name, 0) for name in "bsd")


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


class VisualInertial:
    """The motion of a camera by a map, in its own unit, and the record of a sensor on it that covers the poses.

    Shapes: ``times_s`` (K,), ``covariance`` (6 K, 6 K).

    * ``times_s``: Of the poses, strictly increasing.
    * ``covariance``: Joint covariance of the poses in gtsam's tangent order.
    * ``turning_misfit``: Of the rotations of the map against those of the gyroscope: sum of squares of the normalized
      differences for the best bias, and their number.
    """

    def __init__(
        self, times_s: Floats, world_from_cam: Sequence[Pose], covariance: Floats, record: InertialRecord
    ) -> None:
        self._times_s, self._record = times_s.tolist(), record
        # All is in the first camera, and its pose is held.
        self._first_from_cam = tuple(world_from_cam[0].inverse() @ pose for pose in world_from_cam)
        by_first = np.concatenate([_adjoint(pose.inverse()) for pose in self._first_from_cam[1:]])
        by_all = np.concatenate([-by_first, np.eye(len(by_first))], axis=1)
        self._covariance = by_all @ covariance @ by_all.T
        # Of the accelerometer and of the gyroscope.
        self._bias = np.zeros(6)
        self._bias[3:], *self.turning_misfit = self._gyroscope_bias(self._preintegrated())

    def align(self, far: int) -> Alignment | None:
        """Find scale and gravity.

        * ``far``: Position of the camera whose distance from the first one is asked for.
        * Returns: None where no scale is positive, or where the poses do not determine the unknowns.
        """
        intervals = self._preintegrated()
        start = self._linear_start(intervals)
        if start is None:
            return None
        graph, values = self._graph(intervals, *start)
        params = gtsam.LevenbergMarquardtParams()
        params.setMaxIterations(_ITERATIONS)
        # Some intervals are known to micrometres, and the biases hardly: the squares of normal equations lose the
        # digits.
        params.setLinearSolverType("MULTIFRONTAL_QR")
        try:
            values = gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
            jacobian = graph.linearize(values).jacobian()[0]
            inverse = np.linalg.inv(np.linalg.qr(jacobian, mode="r"))
        except (RuntimeError, np.linalg.LinAlgError):
            return None
        count, arm = len(self._times_s), self._record.cam_from_imu
        # gtsam sorts the unknowns of a matrix by their keys: biases, delay, scale, velocities, poses.
        first, last = (inverse[8 + 3 * count + 6 * k : 14 + 3 * count + 6 * k] for k in (0, far))
        # The camera moves with the sensor, and turns about it.
        by_imu = _adjoint(arm)[3:]
        cameras = [values.atPose3(pose_key(k)).compose(_pose3(arm).inverse()) for k in (0, far)]
        apart = cameras[1].translation() - cameras[0].translation()
        distance_m = float(np.linalg.norm(apart))
        moved = [camera.rotation().unrotate(apart) @ by_imu for camera in cameras]
        log_distance = (moved[1] @ last - moved[0] @ first) / distance_m**2
        by_scales = jacobian.T @ self._by_scales(intervals, values, len(jacobian))
        of_scales = _ACCELEROMETER_SCALE * log_distance @ (inverse.T @ by_scales)
        down = -values.atPose3(pose_key(0)).rotation().matrix().T[:, 2]
        # The heading is free: it turns about gravity, which does not change its direction.
        across, tilts = np.eye(3) - np.outer(down, down), first[:3] @ first[:3].T
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

    # -- measurements ------------------------------------------------------------------------------

    def _preintegrated(
        self, scaled: Floats | tuple[float, ...] = (1.0, 1.0, 1.0)
    ) -> list[gtsam.PreintegratedImuMeasurements]:
        """Preintegrate the record between the poses, with the biases.

        Shapes: ``scaled`` (3,).

        * ``scaled``: Factors on the accelerations along the axes of the sensor.
        """
        intervals, record = [], self._record
        for t0_s, t1_s in pairwise(self._times_s):
            steps = record.steps(t0_s, t1_s)
            assert steps is not None, "the record does not cover the poses"
            durations_s, rates, accelerations = steps
            # An error of the scale of the rates grows with the angle, and noise with the root of the time.
            angle_rad = float(np.linalg.norm(durations_s @ rates))
            rate_variance = record.gyroscope_density**2 + (_GYROSCOPE_SCALE * angle_rad) ** 2 / (t1_s - t0_s)
            params = gtsam.PreintegrationParams.MakeSharedU(STANDARD_GRAVITY)
            params.setGyroscopeCovariance(rate_variance * np.eye(3))
            params.setAccelerometerCovariance(record.accelerometer_density**2 * np.eye(3))
            params.setIntegrationCovariance(1e-10 * np.eye(3))
            bias = gtsam.imuBias.ConstantBias(self._bias[:3], self._bias[3:])
            measured = gtsam.PreintegratedImuMeasurements(params, bias)
            for duration_s, rate, acceleration in zip(durations_s, rates, accelerations * scaled, strict=True):
                measured.integrateMeasurement(acceleration, rate, duration_s)
            intervals.append(measured)
        return intervals

    def _gyroscope_bias(self, intervals: Sequence[gtsam.PreintegratedImuMeasurements]) -> tuple[Floats, float, int]:
        """The bias of the gyroscope by the rotations of the map, the misfit that is left, and the number of residuals.

        The bias turns a short interval by itself times the duration; it is small, and so is the error of this.
        """
        R_cam_from_imu, size = self._record.cam_from_imu.R, 3 * len(intervals)
        residuals, by_poses, noise = [], np.zeros((size, len(self._covariance) + 6)), np.zeros((size, size))
        for k, (interval, (a, b)) in enumerate(zip(intervals, pairwise(self._first_from_cam), strict=True)):
            measured = R_cam_from_imu @ interval.deltaRij().matrix() @ R_cam_from_imu.T
            turned, own = a.R.T @ b.R, slice(3 * k, 3 * k + 3)
            residuals.append(vector_from_rotation(measured.T @ turned))
            by_poses[own, 6 * k : 6 * k + 3] = -turned.T
            by_poses[own, 6 * k + 6 : 6 * k + 9] = np.eye(3)
            noise[own, own] = R_cam_from_imu @ interval.preintMeasCov()[:3, :3] @ R_cam_from_imu.T
        by_poses = by_poses[:, 6:]  # the first pose is held
        covariance = by_poses @ self._covariance @ by_poses.T + noise
        by_bias = np.concatenate([-(t1_s - t0_s) * R_cam_from_imu for t0_s, t1_s in pairwise(self._times_s)])
        stacked = np.concatenate(residuals)
        weighted = np.linalg.solve(covariance, by_bias)
        information = by_bias.T @ weighted + np.eye(3) / _GYROSCOPE_BIAS_RAD_S**2
        bias = np.linalg.solve(information, weighted.T @ stacked)
        left = stacked - by_bias @ bias
        misfit = float(left @ np.linalg.solve(covariance, left)) + float(bias @ bias) / _GYROSCOPE_BIAS_RAD_S**2
        return np.asarray(bias), misfit, len(stacked)

    # -- linear start ------------------------------------------------------------------------------

    def _linear_start(
        self, intervals: Sequence[gtsam.PreintegratedImuMeasurements]
    ) -> tuple[float, Floats, Floats] | None:
        """Scale, gravity (3,) and velocities (K, 3) in the first camera, for given rotations.

        The norm of gravity is known, which is not linear: it is stated along the last estimate of its direction.
        """
        arm, size = self._record.cam_from_imu, 4 + 3 * len(self._times_s)
        variances = self._covariance.diagonal().reshape(-1, 6)[:, 3:].mean(axis=1)
        scale, gravity = 1.0, np.zeros(3)
        for _ in range(_STARTS):
            rows, right = [], []
            for k, measured in enumerate(intervals):
                a, b = self._first_from_cam[k], self._first_from_cam[k + 1]
                dt, rotation = self._times_s[k + 1] - self._times_s[k], a.R @ arm.R
                # Unknowns: scale, gravity, velocities.
                place, speed = np.zeros((3, size)), np.zeros((3, size))
                place[:, 0], place[:, 1:4] = b.t - a.t, -0.5 * dt**2 * np.eye(3)
                place[:, 4 + 3 * k : 7 + 3 * k] = -dt * np.eye(3)
                speed[:, 1:4] = -dt * np.eye(3)
                speed[:, 4 + 3 * k : 7 + 3 * k], speed[:, 7 + 3 * k : 10 + 3 * k] = -np.eye(3), np.eye(3)
                noise = np.sqrt(np.diag(measured.preintMeasCov()))
                sigma = math.hypot(scale * math.sqrt(variances[k] + variances[max(k - 1, 0)]), noise[3])
                rows += [place / sigma, speed / noise[6]]
                right.append((rotation @ measured.deltaPij() + (a.R - b.R) @ arm.t) / sigma)
                right.append(rotation @ measured.deltaVij() / noise[6])
            if gravity.any():
                row = np.zeros((1, size))
                row[0, 1:4] = gravity / np.linalg.norm(gravity) / ACCELEROMETER_BIAS_M_S2
                rows.append(row)
                right.append(np.array([STANDARD_GRAVITY / ACCELEROMETER_BIAS_M_S2]))
            solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right))[0]
            scale, gravity = abs(float(solution[0])) or 1.0, solution[1:4]
            if not gravity.any():
                return None
        return (scale, gravity, solution[4:].reshape(-1, 3)) if solution[0] > 0 else None

    # -- joint estimate ----------------------------------------------------------------------------

    def _graph(
        self,
        intervals: Sequence[gtsam.PreintegratedImuMeasurements],
        scale: float,
        gravity: Floats,
        velocities: Floats,
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """All factors, and a start."""
        arm, upright_from_first = self._record.cam_from_imu, _upright(gravity)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for k, (pose, velocity) in enumerate(zip(self._first_from_cam, velocities, strict=True)):
            rotation, place = pose.R @ arm.R, scale * pose.t + pose.R @ arm.t
            values.insert(pose_key(k), _pose3(Pose(upright_from_first @ rotation, upright_from_first @ place)))
            values.insert(_velocity_key(k), upright_from_first @ velocity)
        values.insert(_BIAS, gtsam.imuBias.ConstantBias(self._bias[:3], self._bias[3:]))
        values.insert(_SCALE, np.array([math.log(scale)]))
        values.insert(_DELAY, np.zeros(1))
        for factor in _inertial_factors(intervals):
            graph.add(factor)
        # A prior of the first pose holds its heading and its place.
        first = values.atPose3(pose_key(0))
        up = first.rotation().matrix().T[:, 2]
        covariance = np.diag(np.repeat([_FREE_RAD**2, _HELD_M**2], 3))
        covariance[:3, :3] += (_HELD_RAD**2 - _FREE_RAD**2) * np.outer(up, up)
        graph.add(gtsam.PriorFactorPose3(pose_key(0), first, gtsam.noiseModel.Gaussian.Covariance(covariance)))
        diagonal = gtsam.noiseModel.Diagonal.Sigmas
        offsets = diagonal(np.repeat([ACCELEROMETER_BIAS_M_S2, _GYROSCOPE_BIAS_RAD_S], 3))
        graph.add(gtsam.PriorFactorConstantBias(_BIAS, gtsam.imuBias.ConstantBias(), offsets))
        clock = diagonal(np.array([max(self._record.clock_sigma_s, 1e-6)]))
        graph.add(gtsam.PriorFactorVector(_DELAY, np.zeros(1), clock))
        graph.add(self._map_factor())
        return graph, values

    def _by_scales(
        self, intervals: Sequence[gtsam.PreintegratedImuMeasurements], values: gtsam.Values, rows: int
    ) -> Floats:
        """How the normalized residuals follow the scale of each axis of the accelerometer, which is no unknown.

        Shapes: returns (R, 3).

        * ``rows``: Number of residuals R; those of the intervals are the first ones.
        """
        derivatives = np.zeros((rows, 3))

        def residuals(ones: Sequence[gtsam.PreintegratedImuMeasurements]) -> Floats:
            return np.concatenate([factor.whitenedError(values) for factor in _inertial_factors(ones)])

        known = residuals(intervals)
        for axis in range(3):
            changed = self._preintegrated(1.0 + _SCALE_STEP * np.eye(3)[axis])
            derivatives[: len(known), axis] = (residuals(changed) - known) / _SCALE_STEP
        return derivatives

    def _map_factor(self) -> gtsam.CustomFactor:
        """The factor of the map: its poses in the first camera, with their joint covariance.

        A camera whose clock is late shows the pose at which the sensor was before: it moves on by its velocity.
        """
        count, record, imu_from_cam = len(self._times_s), self._record, self._record.cam_from_imu.inverse()
        arm, by_imu = _pose3(imu_from_cam), _adjoint(imu_from_cam.inverse())
        rates = np.array([record.rates_rad_s[np.argmin(np.abs(record.timestamps_s - t))] for t in self._times_s])
        keys = [*map(pose_key, range(count)), *map(_velocity_key, range(count)), _BIAS, _SCALE, _DELAY]
        # Columns of the derivatives: poses, velocities, biases, scale and delay.
        borders = np.cumsum([*(count * [6]), *(count * [3]), 6, 1])

        def error(_: Any, values: gtsam.Values, jacobians: list[Floats] | None) -> Floats:
            scale, delay_s = math.exp(float(values.atVector(_SCALE)[0])), float(values.atVector(_DELAY)[0])
            rate_bias = values.atConstantBias(_BIAS).gyroscope()
            cameras, twists = [], []
            for k in range(count):
                pose = values.atPose3(keys[k])
                velocity = pose.rotation().matrix().T @ values.atVector(keys[count + k])
                twists.append(by_imu @ np.concatenate([rates[k] - rate_bias, velocity]))
                cameras.append(pose.compose(arm).compose(gtsam.Pose3.Expmap(delay_s * twists[k])))
            residuals, derivatives = np.zeros((count - 1, 6)), np.zeros((6 * count - 6, 9 * count + 8))
            for k in range(1, count):
                seen, between = self._first_from_cam[k], cameras[0].between(cameras[k])
                off, moved = seen.R.T @ between.rotation().matrix(), seen.R.T @ between.translation() / scale
                residuals[k - 1, :3] = vector_from_rotation(off)
                residuals[k - 1, 3:] = moved - seen.R.T @ seen.t
                # By the motion of the camera in its own axes; the residual of the rotation is small.
                rows, by_camera = derivatives[6 * k - 6 : 6 * k], np.zeros((6, 6))
                by_camera[:3, :3], by_camera[3:, 3:] = np.eye(3), off / scale
                by_first = -by_camera @ between.inverse().AdjointMap()
                rows[:, 6 * k : 6 * k + 6], rows[:, :6] = by_camera @ by_imu, by_first @ by_imu
                rows[3:, -2], rows[:, -1] = -moved, by_camera @ twists[k] + by_first @ twists[0]
            if jacobians is not None:
                for number, part in enumerate(np.split(derivatives, borders, axis=1)):
                    jacobians[number] = part
            return residuals.ravel()

        return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(self._covariance), keys, error)


def _inertial_factors(intervals: Sequence[gtsam.PreintegratedImuMeasurements]) -> list[gtsam.ImuFactor]:
    factors = []
    for k, measured in enumerate(intervals):
        at = pose_key(k), _velocity_key(k), pose_key(k + 1), _velocity_key(k + 1)
        factors.append(gtsam.ImuFactor(*at, _BIAS, measured))
    return factors


def _velocity_key(k: int) -> int:
    return int(gtsam.symbol("v", k))


def _pose3(pose: Pose) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(pose.R), pose.t)


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
