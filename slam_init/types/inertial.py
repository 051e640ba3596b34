"""What moves with the camera and is no camera: an inertial sensor, the direction of gravity, measured rotations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quest.display import Described
from slam_init.errors import SlamInitError, SourceError
from slam_init.types.arrays import Floats, as_array, as_number, set_fields
from slam_init.types.pose import Pose

#: Standard gravity in m/s^2. On the earth it differs by 0.27 % at most at sea level.
STANDARD_GRAVITY = 9.80665
#: Longest step between two samples. A hand turns by 1 rad/s at up to 2 Hz, so that the second derivative of the rate is
#: at most 160 rad/s^3. The integral of the interpolated rate is then off by 160 dt^3 / 12, which is 1 mrad for 0.04 s,
#: as much as the noise of other measurements.
LONGEST_STEP_S = 0.04
#: Offset of an accelerometer: data sheets of phones state 20 to 40 mg before, and their makers 5 to 10 mg after
#: calibration. In it are the scale of its axes, 0.5 % of gravity, and the norm of gravity, 0.3 %.
#: Class: assumption.
ACCELEROMETER_BIAS_M_S2 = 0.12
#: An accelerometer is at rest where its norm is that of gravity up to three offsets, and its scatter within this time
#: less than the offset: a hand that holds still scatters by as much.
#: Class: level.
_REST_S, _REST_BIASES = 0.2, 3.0
#: Where the lever arm would be longer, it is not in metres: no phone, drone or car has its sensor so far away.
_FARTHEST_M = 10.0
#: A matrix that is farther from a rotation was not meant as one: numbers of four digits are nearer.
_NOT_A_ROTATION = 1e-3
#: Standard deviations of a measured rotation, in radians: nothing measures better than the least; more than the most is
#: no measurement.
_SIGMAS_RAD = (1e-6, 1.0)


@dataclass(frozen=True, eq=False)
class InertialRecord:
    """Angular rates and accelerations over time, as the sensor measured them.

    Attributes
    ----------
    timestamps_s : (N,) float
        Strictly increasing, on the clock of the frames.
    rates_rad_s : (N, 3) float
        Angular velocity of the sensor in its own axes.
    accelerations_m_s2 : (N, 3) float
        Specific force in its own axes: at rest it points up, and its norm is that of gravity.
    cam_from_imu : Pose
        The pose of the sensor in the camera, in metres.
    gyroscope_density : float
        White noise of the rates in rad/s/sqrt(Hz). By default that of the sensors in phones, 0.01 deg/s/sqrt(Hz).
    accelerometer_density : float
        White noise of the accelerations in m/s^2/sqrt(Hz). By default that of the sensors in phones, 200 ug/sqrt(Hz).
    clock_sigma_s : float
        Standard deviation of the delay between the clocks of sensor and camera.
    name : str
        For messages.

    Raises
    ------
    SourceError
        If the arrays are no such record.
    """

    timestamps_s: Floats
    rates_rad_s: Floats
    accelerations_m_s2: Floats
    cam_from_imu: Pose
    gyroscope_density: float = 2e-4
    accelerometer_density: float = 2e-3
    clock_sigma_s: float = 0.001
    name: str = "the inertial record"

    def __post_init__(self) -> None:
        for values in (self.rates_rad_s, self.accelerations_m_s2):
            check_samples(self.name, self.timestamps_s, values)
        wrong = self.cam_from_imu.problem()
        if wrong is not None or np.abs(self.cam_from_imu.t).max() > _FARTHEST_M:
            wrong = wrong or f"is {np.abs(self.cam_from_imu.t).max():.3g} m away: give metres"
            raise SourceError(f"{self.name}: the pose of the sensor in the camera {wrong}")
        check_deviations(self.name, self.gyroscope_density, self.accelerometer_density, self.clock_sigma_s)

    def steps(self, t0_s: float, t1_s: float) -> tuple[Floats, Floats, Floats] | None:
        """The measurements between two times.

        Returns
        -------
        durations_s : (S,) float
        rates_rad_s, accelerations_m_s2 : (S, 3) float
            The mean of each step, where the samples are interpolated linearly. None in place of all three where a time
            lies outside of the record, or two samples are more than 0.04 s apart.
        """
        knots = knots_between(self.timestamps_s, t0_s, t1_s)
        if knots is None:
            return None
        rates, accelerations = (
            np.stack([np.interp(knots, self.timestamps_s, axis) for axis in values.T], axis=1)
            for values in (self.rates_rad_s, self.accelerations_m_s2)
        )
        return np.diff(knots), 0.5 * (rates[1:] + rates[:-1]), 0.5 * (accelerations[1:] + accelerations[:-1])

    def gravity_at(self, time_s: float) -> Gravity | None:
        """The direction of gravity in the camera.

        Parameters
        ----------
        time_s : float

        Returns
        -------
        Gravity or None
            None where the sensor does not rest for 0.2 s around this time, or the record does not cover it.
        """
        steps = self.steps(time_s - 0.5 * _REST_S, time_s + 0.5 * _REST_S)
        if steps is None:
            return None
        force = steps[2].mean(axis=0)
        scatter = float(np.linalg.norm(steps[2].std(axis=0)))
        off = abs(float(np.linalg.norm(force)) - STANDARD_GRAVITY)
        if scatter > ACCELEROMETER_BIAS_M_S2 or off > _REST_BIASES * ACCELEROMETER_BIAS_M_S2:
            return None
        sigma_deg = math.degrees(math.hypot(ACCELEROMETER_BIAS_M_S2, scatter) / STANDARD_GRAVITY)
        return Gravity(-self.cam_from_imu.R @ force, sigma_deg)


@dataclass(frozen=True, eq=False, repr=False)
class Gravity(Described):
    """The direction of gravity.

    Attributes
    ----------
    down : (3,) float
        Unit vector to the centre of the earth: in the camera for a frame, in the world for a map.
    sigma_deg : float
        Standard deviation of each of its two angles.

    Raises
    ------
    SlamInitError
        If the vector is zero or not finite, or the deviation not from 0.001 to 45 degrees.
    """

    down: Floats
    sigma_deg: float

    def __post_init__(self) -> None:
        give = "a vector of three finite numbers that points down, as (0, 1, 0)"
        down = as_array(self.down, np.float64, (3,), "gravity", give)
        length = float(np.linalg.norm(down))
        if not 0 < length < math.inf:
            raise SlamInitError(f"gravity has the length {length:g}: give {give}")
        sigma_deg = as_number(self.sigma_deg, "the deviation of gravity", "degrees from 0.001 to 45")
        if not 1e-3 <= sigma_deg <= 45:
            raise SlamInitError(f"the deviation of gravity is {sigma_deg!r}: give degrees from 0.001 to 45")
        set_fields(self, down=down / length, sigma_deg=sigma_deg)

    @staticmethod
    def check(thing: object) -> None:
        """Refuse what is no direction of gravity.

        Parameters
        ----------
        thing : object
            What the caller gave for one. None is allowed: there is none.

        Raises
        ------
        SlamInitError
        """
        if not isinstance(thing, Gravity | None):
            raise SlamInitError(f"gravity is {thing!r:.60}: give Gravity(down, sigma_deg) in the axes of the camera")

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        x, y, z = self.down.tolist()
        return f"gravity along ({x:.3f}, {y:.3f}, {z:.3f}), +- {self.sigma_deg:.2g} deg", []


@dataclass(frozen=True, eq=False)
class RelativeRotation:
    """The rotation of the camera since some frame, by a gyroscope, a robot's arm or another tracker."""

    #: (3, 3)
    cam_from_start: Floats
    #: Of each component of its rotation vector; the sum of those of the steps.
    variance_rad2: float
    #: Frame since which the rotation of every frame was measured.
    start: int

    def after(self, rotation: Floats, sigma_rad: float) -> RelativeRotation:
        """The relative rotation of the next frame.

        Shapes: ``rotation`` (3, 3).
        """
        return RelativeRotation(rotation @ self.cam_from_start, self.variance_rad2 + sigma_rad**2, self.start)


def checked_rotation(rotation: object, sigma_rad: float) -> Floats:
    """Check a measured rotation.

    Shapes: ``rotation`` (3, 3), returns (3, 3).
    """
    R = as_array(rotation, np.float64, (3, 3), "rotation", "a 3x3 matrix from the axes of the last camera to these")
    U, _, Vt = np.linalg.svd(R)
    nearest = np.asarray(U @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))]) @ Vt)
    if not np.abs(nearest - R).max() <= _NOT_A_ROTATION:  # nor NaN, of numbers that are too large
        raise SlamInitError("rotation: the matrix is no rotation: its columns must be orthonormal, its determinant 1")
    if not _SIGMAS_RAD[0] <= as_number(sigma_rad, "rotation_sigma_rad", "radians from 1e-6 to 1") <= _SIGMAS_RAD[1]:
        raise SlamInitError(f"rotation_sigma_rad is {sigma_rad!r}: give radians from 1e-6 to 1")
    return nearest


def knots_between(timestamps_s: Floats, t0_s: float, t1_s: float) -> Floats | None:
    """Two times and those of the samples between them; None outside of the record or across a gap.

    Shapes: ``timestamps_s`` (N,), returns (S + 1,).
    """
    times = timestamps_s
    if not times[0] <= t0_s < t1_s <= times[-1]:
        return None
    first, last = np.searchsorted(times, t0_s, "right") - 1, np.searchsorted(times, t1_s, "left")
    if np.diff(times[first : last + 1]).max() > LONGEST_STEP_S:
        return None
    return np.concatenate([[t0_s], times[first + 1 : last], [t1_s]])


def check_samples(name: str, timestamps_s: Floats, values: Floats) -> None:
    """Refuse what is no record of three numbers over time.

    Shapes: ``timestamps_s`` (N,), ``values`` (N, 3).
    """
    times, values = np.asarray(timestamps_s, float), np.asarray(values, float)
    if times.ndim != 1 or len(times) < 2 or values.shape != (len(times), 3):
        raise SourceError(f"{name}: {times.shape} times and {values.shape} samples: give (N,) and (N, 3), N >= 2")
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise SourceError(f"{name}: a time stamp or a sample is not a finite number")
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        raise SourceError(f"{name}: sample {late[0] + 2} does not come after the one before: sort them")


def check_deviations(name: str, *sigmas: float) -> None:
    """Refuse standard deviations and noise densities that are none."""
    if not all(math.isfinite(sigma) and sigma >= 0 for sigma in sigmas):
        raise SourceError(f"{name}: a standard deviation or noise density is negative or not finite")
